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
// Of alarms whose size is no error of the position: it is known as of the event only.
const OTHER = ['noise', 'rate_bias'], SIZELESS = ['spike', 'dropout'];
const WORDS = { spike: 'single wrong readings (spike)', stuck: 'reading stands still (stuck)',
  noise: 'too much noise', dropout: 'no readings (dropout)' };

const DIGITS = { m: 4, N: 2 };
const bare = (value, unit) => (value == null ? '–' : value.toFixed(DIGITS[unit[0]] ?? 3));
const plain = (value, unit) => (value == null ? '–' : `${bare(value, unit)} ${unit}`);
const show = (value, unit) => (value == null ? '–'
  : (value >= 0 ? '+' : '−') + plain(Math.abs(value), unit));
// One, exactly, is a guarantee.
const sure = (p) => (p == null ? '–' : p === 1 ? 'guaranteed'
  : p < 0.9995 ? `${(100 * p).toFixed(1)}%` : '> 99.9%');

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
  hello.units.forEach(([unit], i) => showSensor(byId(`sensor-${i}`), i, unit, frame));
  put(byId('torque-now'), sample.torque[0] == null ? 'none'
    : sample.torque.map((v, i) => torque(v, ...hello.units.slice(i, i + 2))).join(' / '));
  byId('key-true').hidden = !live.ground_truth;
  showDiagnostics(frame.diagnostics);
}

// The unit stands after the last of those that have it.
function torque(value, [, unit], next) {
  return show(value, unit).replace(next?.[1] === unit ? ` ${unit}` : '', '');
}

function showSensor(card, i, unit, { states, sample: { estimate, bound, threshold } }) {
  mark(card.querySelector('.pill'), 'pill', STATE[states[i]] ?? ['stale', '◌ no data']);
  put(card.querySelector('.reading b'), show(estimate[i], unit));
  put(card.querySelector('.reading span'),
    `± ${bare(bound[i], unit)}, threshold ${bare(threshold[i], unit)}`);
}

function verdict(kind, icon, head, text) {
  const element = byId('verdict');
  if (!element.classList.contains(kind)) element.className = `verdict ${kind}`;
  put(byId('verdict-icon'), icon);
  put(byId('verdict-head'), head);
  put(byId('verdict-text'), text);
}

// What is faulty, and the unit of the error.
function about({ sensor, kind }, { sensors, units }) {
  const unit = units[sensors.indexOf(sensor)]?.[0] ?? '';
  return kind === 'rate_bias' ? [`${sensor} (rate)`, `${unit}/s`] : [sensor, unit];
}

// An alarm in the words of the log.  Its error is that of now, as on the sensor's card, where there
// is one; without a bound nothing is known of it.
function describe(row, { live, sample }, hello) {
  const [what, unit] = about(row, hello), i = hello.sensors.indexOf(row.sensor);
  const now = i >= 0 && !OTHER.includes(row.kind) && live.fault_estimate;
  const [size, bound] = now ? [sample.estimate[i], sample.bound[i]] : [row.size, row.bound];
  const error = bound == null ? 'error of unknown size'
    : `error ${show(size, unit)}${bound ? ` (bound ${plain(bound, unit)})` : ''}`;
  const parts = [SIZELESS.includes(row.kind) ? '' : error, WORDS[row.kind] ?? row.kind,
    row.confidence === 1 ? 'guaranteed' : `confidence ${sure(row.confidence)}`];
  return `${what}: ${parts.filter(Boolean).join(', ')}`;
}

// The answer to the operator's question: which sensor is faulty, by how much, how sure is that?
function showVerdict(frame, alarms, hello, silent) {
  const { states, stops } = frame, open = alarms.filter((row) => row.ended == null);
  const named = (state) => hello.sensors.filter((_, i) => states[i] === state);
  const failed = frame.diagnostics.filter(({ level, own }) => own && level === 'ERROR');
  const faulty = new Set([...open.map((row) => about(row, hello)[0]), ...named('ERROR')]);
  if (silent) {
    const since = frame.age == null ? '' : ` The last message came ${Math.floor(frame.age)} s ago.`;
    verdict('stale', '◌', 'No data from the graph', since);
  } else if (faulty.size) {
    const text = open.map((row) => describe(row, frame, hello)).join('; ');
    verdict('error', '✕', `${[...faulty].join(' and ')} ${faulty.size > 1 ? 'are' : 'is'} faulty`,
      text || ' The alarm itself was not received.');
  } else if (frame.trustworthy === false) {
    verdict('error', '✕', 'The estimate is not trustworthy', ' The arm must not rely on it.');
  } else if (failed.length) {
    // As the tracker and the drives say it.
    const stopped = failed.some((s) => /^(safe stop|braked)\b/.test(s.message));
    verdict('error', '✕', stopped ? 'The arm is stopped' : 'A node reports an error',
      failed.map((s) => `${s.name}: ${s.message}`).join('; '));
  } else if (!frame.live.fault_estimate) {
    verdict('stale', '◌', 'No diagnosis', ' The observer sends no fault estimates.');
  } else if (states.includes('WARN')) {
    verdict('warn', '▲', 'Something may be wrong',
      ` Suspected, not confirmed: ${named('WARN').join(', ')}`);
  } else if (stops.recent) {
    verdict('warn', '▲', 'No sensor fault, but the arm was stopped',
      ` ${stops.count} safe stops so far; the last: ${stops.last}`);
  } else if (states.some((state) => state === 'STALE' || state === 'NOT_DIAGNOSABLE')) {
    verdict('stale', '?', 'No alarm, but not all can be diagnosed',
      ` ${[...named('STALE'), ...named('NOT_DIAGNOSABLE')].join(', ')}`);
  } else {
    verdict('ok', '✓', 'No sensor fault', ' All estimates are below their thresholds.');
  }
}

let shownDiagnostics = '[]';

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

export function showAlarms(alarms, hello) {
  const rows = alarms.slice().reverse().map((alarm) => {
    const open = alarm.ended == null, [, unit] = about(alarm, hello);
    const sizes = SIZELESS.includes(alarm.kind) ? ['–', '–']
      : [show(alarm.size, unit), plain(alarm.bound || null, unit)];
    const cells = [make('span', `pill ${open ? 'error' : 'stale'}`, open ? '✕ ALARM' : 'over'),
      alarm.sensor, alarm.kind, ...sizes, sure(alarm.confidence),
      time(alarm.onset), time(alarm.detected), time(alarm.ended)];
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
