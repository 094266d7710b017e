// Text of the page: badges, verdict, readings, alarms, diagnostics.  Only textContent is written.

export const byId = (id) => document.getElementById(id);
const STATE = {
  OK: ['ok', '✓ OK'], WARN: ['warn', '▲ warning'], ERROR: ['error', '✕ faulty'],
  STALE: ['stale', '◌ stale'], NOT_DIAGNOSABLE: ['stale', '? not diagnosable'],
};
const MODE = {
  OBSERVING: ['ok', 'observing'], HOLDING: ['warn', 'holding: dead reckoning'],
  INITIALISING: ['stale', 'initialising'], STALE: ['stale', 'stale'],
  NO_ESTIMATE: ['stale', 'no estimate'],
};
const LINK = { connected: ['ok', 'connected'],
  reconnecting: ['error', 'connection lost, trying again'] };
// Of alarms whose size is no position error: it is known as of the event only.
const UNITS = { rate_bias: ' rad/s', torque_offset: ' N m', torque_gain: '', contact: ' N m' };

const show = (value, digits = 3) => (value == null ? '–'
  : (value >= 0 ? '+' : '−') + Math.abs(value).toFixed(digits));
const plain = (value, digits = 3) => (value == null ? '–' : value.toFixed(digits));

// Wall-clock stamps as time of day, simulated ones in seconds.
function time(t) {
  if (t == null) return '–';
  if (t < 1e8) return `${t.toFixed(2)} s`;
  const date = new Date(t * 1000), two = (n) => String(n).padStart(2, '0');
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.`
    + String(date.getMilliseconds()).padStart(3, '0').slice(0, 2);
}

function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function make(tag, name, ...content) {
  const element = document.createElement(tag);
  element.className = name;
  element.append(...content);
  return element;
}

function mark(element, look, [kind, text]) {
  element.hidden = false;
  if (!element.classList.contains(kind)) element.className = `${look} ${kind}`;
  put(element, text);
}

export function showLink(state) {
  mark(byId('connection'), 'badge', LINK[state]);
  if (state !== 'connected') {
    verdict('stale', '◌', 'No connection to the node', ' What is shown is no longer live.');
  }
}

export function showFrame(frame, alarms, hello) {
  const { live, sample, stops } = frame;
  const silent = !(live.state_estimate || live.joint_states);
  mark(byId('mode'), 'badge', silent ? ['stale', 'no data'] : MODE[frame.mode]
    ?? ['stale', 'no observer']);
  mark(byId('trust'), 'badge', frame.safe_stop && live.torque_command ? ['error', 'safe stop']
    : frame.trustworthy ? ['ok', 'trustworthy'] : ['error', 'not trustworthy']);
  byId('trust').hidden = frame.trustworthy == null || silent;
  mark(byId('stops'), 'badge', ['warn',
    `${stops.count} safe stop${stops.count > 1 ? 's, the last' : ''}: ${stops.last}`]);
  byId('stops').hidden = !stops.count;
  byId('clock').hidden = sample.t == null;
  put(byId('clock'), time(sample.t));
  showVerdict(frame, alarms, hello, silent);
  hello.sensors.forEach((_, i) => showSensor(byId(`sensor-${i}`), i, frame));
  put(byId('torque-now'), sample.torque[0] == null ? 'none'
    : `${sample.torque.map((v) => show(v, 1)).join(' / ')} N m`);
  byId('key-true').hidden = !live.ground_truth;
  showDiagnostics(frame.diagnostics);
}

function showSensor(card, i, { live, states, sample: { estimate, bound, threshold } }) {
  const state = live.fault_estimate ? STATE[states[i]] : null;
  mark(card.querySelector('.pill'), 'pill', state ?? ['stale', '◌ no data']);
  put(card.querySelector('.reading b'), `${show(estimate[i])} rad`);
  put(card.querySelector('.reading span'),
    `± ${plain(bound[i])}, threshold ${plain(threshold[i])}`);
}

function verdict(kind, icon, head, text) {
  const element = byId('verdict');
  if (!element.classList.contains(kind)) element.className = `verdict ${kind}`;
  put(byId('verdict-icon'), icon);
  put(byId('verdict-head'), head);
  put(byId('verdict-text'), text);
}

// The fault estimate now, as on the sensor's card; of an alarm that has none, that of its event.
function sizeOf(row, { live, sample }, sensors) {
  const i = sensors.indexOf(row.sensor), now = i >= 0 && !(row.kind in UNITS) && live.fault_estimate;
  const [size, bound] = now ? [sample.estimate[i], sample.bound[i]] : [row.size, row.bound];
  return `${show(size)} ± ${plain(bound)}${UNITS[row.kind] ?? ' rad'}`;
}

// The answer to the operator's question: which sensor is faulty, by how much, how sure is that?
function showVerdict(frame, alarms, hello, silent) {
  const open = alarms.filter((row) => row.ended == null), { states, stops } = frame;
  const failed = frame.diagnostics.filter((status) => status.level === 'ERROR');
  if (silent) {
    const since = frame.age == null ? '' : ` The last message came ${Math.floor(frame.age)} s ago.`;
    verdict('stale', '◌', 'No data from the graph', since);
  } else if (open.length) {
    const text = open.map((row) => `${row.sensor}: ${sizeOf(row, frame, hello.sensors)}, `
      + `${row.kind}, confidence ${plain(row.confidence, 2)}`).join('; ');
    const names = [...new Set(open.map((row) => row.sensor))].join(' and ');
    verdict('error', '✕', `${names} ${open.length > 1 ? 'are' : 'is'} faulty`, text);
  } else if (frame.trustworthy === false) {
    verdict('error', '✕', 'The estimate is not trustworthy', ' The arm must not rely on it.');
  } else if (failed.length) {
    verdict('error', '✕', 'The arm is stopped', ` ${failed.map((s) => s.message).join('; ')}`);
  } else if (!frame.live.fault_estimate) {
    verdict('stale', '◌', 'No diagnosis', ' The observer sends no fault estimates.');
  } else if (states.includes('WARN')) {
    verdict('warn', '▲', 'Something may be wrong', ' Above a threshold, not confirmed.');
  } else if (stops.recent) {
    verdict('warn', '▲', 'No sensor fault, but the arm was stopped',
      ` ${stops.count} safe stops so far; the last: ${stops.last}`);
  } else if (states.some((state) => state === 'STALE' || state === 'NOT_DIAGNOSABLE')) {
    const names = hello.sensors.filter((_, i) => states[i] !== 'OK').join(', ');
    verdict('stale', '?', 'No alarm, but not all can be diagnosed', ` ${names}`);
  } else {
    verdict('ok', '✓', 'No sensor fault', ' All estimates are below their thresholds.');
  }
}

let shownDiagnostics = '';

function showDiagnostics(list) {
  const key = JSON.stringify(list);
  if (key === shownDiagnostics) return;
  shownDiagnostics = key;
  byId('diagnostics').replaceChildren(...list.map(({ name, level, message }) => {
    const kind = { OK: 'ok', WARN: 'warn', ERROR: 'error' }[level] ?? 'stale';
    return make('li', '', make('span', `pill ${kind}`, level), make('b', '', name),
      make('span', '', message));
  }));
}

export function showAlarms(alarms) {
  const rows = alarms.slice().reverse().map((alarm) => {
    const open = alarm.ended == null, unit = UNITS[alarm.kind] ?? '';
    const cells = [make('span', `pill ${open ? 'error' : 'stale'}`, open ? '✕ ALARM' : 'over'),
      alarm.sensor, alarm.kind, show(alarm.size) + unit, plain(alarm.bound) + unit,
      plain(alarm.confidence), time(alarm.onset), time(alarm.detected), time(alarm.ended)];
    const row = make('tr', open ? 'open' : '',
      ...cells.map((content, i) => make('td', i > 2 ? 'number' : '', content)));
    row.dataset.sensor = alarm.sensor;
    return row;
  });
  if (!rows.length) {
    rows.push(make('tr', 'none', make('td', '', 'none')));
    rows[0].firstChild.colSpan = 9;
  }
  byId('alarms').replaceChildren(...rows);
}
