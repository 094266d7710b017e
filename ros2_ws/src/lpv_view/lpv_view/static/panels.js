// Text of the page: badges, verdict, readings, alarms, diagnostics.  Only textContent is written.

const byId = (id) => document.getElementById(id);
const STATE = {
  OK: ['ok', '✓ OK'], WARN: ['warn', '▲ warning'], ERROR: ['error', '✕ faulty'],
  STALE: ['stale', '◌ stale'], NOT_DIAGNOSABLE: ['stale', '? not diagnosable'],
};
const MODE = {
  OBSERVING: ['ok', 'observing'], HOLDING: ['warn', 'holding: dead reckoning'],
  INITIALISING: ['stale', 'initialising'], STALE: ['stale', 'stale'],
  NO_ESTIMATE: ['stale', 'no estimate'],
};
const LINK = { connected: ['ok', 'connected'], silent: ['stale', 'no answer'],
  reconnecting: ['error', 'connection lost, trying again'] };

export const show = (value, digits = 3) => (value == null ? '–'
  : (value >= 0 ? '+' : '−') + Math.abs(value).toFixed(digits));
export const plain = (value, digits = 3) => (value == null ? '–' : value.toFixed(digits));

// Wall-clock stamps as time of day, simulated ones in seconds.
export function time(t) {
  if (t == null) return '–';
  if (t < 1e8) return `${t.toFixed(2)} s`;
  const date = new Date(t * 1000), two = (n) => String(n).padStart(2, '0');
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.`
    + String(date.getMilliseconds()).padStart(3, '0').slice(0, 2);
}

function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function badge(id, [kind, text]) {
  const element = byId(id);
  element.hidden = false;
  if (!element.classList.contains(kind)) element.className = `badge ${kind}`;
  put(element, text);
}

export function showLink(state) {
  badge('connection', LINK[state]);
  if (state !== 'connected') {
    verdict('stale', '◌', 'No connection to the node', ' What is shown is no longer live.');
  }
}

export function showFrame(frame, alarms, hello) {
  const silent = !(frame.live.state_estimate || frame.live.joint_states);
  badge('mode', silent ? ['stale', 'no data'] : MODE[frame.mode] ?? ['stale', 'no observer']);
  const stop = frame.safe_stop && frame.live.torque_command;
  byId('trust').hidden = frame.trustworthy == null || silent;
  if (!byId('trust').hidden) {
    badge('trust', stop ? ['error', 'safe stop'] : frame.trustworthy
      ? ['ok', 'trustworthy'] : ['error', 'not trustworthy']);
  }
  byId('clock').hidden = frame.sample.t == null;
  put(byId('clock'), time(frame.sample.t));
  showVerdict(frame, alarms, hello, silent);
  hello.sensors.forEach((_, i) => showSensor(i, frame));
  const torque = frame.sample.torque;
  put(byId('torque-now'), torque[0] == null ? 'none' : torque.map((v) => show(v, 1)).join(' / ')
    + ' N m');
  for (const name of ['true', 'estimated', 'measured']) {
    byId(`key-${name}`).hidden = name === 'true' && !frame.live.ground_truth;
  }
  showDiagnostics(frame.diagnostics);
}

function showSensor(i, frame) {
  const card = byId(`sensor-${i}`), { estimate, bound, threshold } = frame.sample;
  const [kind, text] = frame.live.fault_estimate
    ? STATE[frame.states[i]] ?? ['stale', '◌ no data'] : ['stale', '◌ no data'];
  const pill = card.querySelector('.pill');
  if (!pill.classList.contains(kind)) pill.className = `pill ${kind}`;
  put(pill, text);
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

// The answer to the operator's question: which sensor is faulty, by how much, how sure is that?
function showVerdict(frame, alarms, hello, silent) {
  const open = alarms.filter((row) => row.ended == null);
  if (silent) {
    const since = frame.age == null ? '' : ` The last message came ${Math.floor(frame.age)} s ago.`;
    verdict('stale', '◌', 'No data from the graph', since);
  } else if (open.length) {
    const text = open.map((row) => `${row.sensor}: ${show(row.size)} ± ${plain(row.bound)} rad, `
      + `${row.kind}, confidence ${plain(row.confidence, 2)}`).join('; ');
    const names = [...new Set(open.map((row) => row.sensor))].join(' and ');
    verdict('error', '✕', `${names} ${open.length > 1 ? 'are' : 'is'} faulty`, text);
  } else if (frame.trustworthy === false) {
    verdict('error', '✕', 'The estimate is not trustworthy', ' The arm must not rely on it.');
  } else if (frame.diagnostics.some((status) => status.level === 'ERROR')) {
    const failed = frame.diagnostics.filter((status) => status.level === 'ERROR');
    verdict('error', '✕', 'The arm is stopped', ` ${failed.map((s) => s.message).join('; ')}`);
  } else if (!frame.live.fault_estimate) {
    verdict('stale', '◌', 'No diagnosis', ' The observer sends no fault estimates.');
  } else if (frame.states.includes('WARN')) {
    verdict('warn', '▲', 'Something may be wrong', ' Above a threshold, not confirmed.');
  } else if (frame.states.some((state) => state === 'STALE' || state === 'NOT_DIAGNOSABLE')) {
    const names = hello.sensors.filter((_, i) => frame.states[i] !== 'OK').join(', ');
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
    const [item, pill, title, text] = ['li', 'span', 'b', 'span'].map((tag) =>
      document.createElement(tag));
    const kind = { OK: 'ok', WARN: 'warn', ERROR: 'error' }[level] ?? 'stale';
    pill.className = `pill ${kind}`;
    pill.textContent = level;
    title.textContent = name;
    text.textContent = message;
    item.append(pill, title, text);
    return item;
  }));
}

export function showAlarms(alarms) {
  const rows = alarms.slice().reverse().map((alarm) => {
    const row = document.createElement('tr');
    const open = alarm.ended == null;
    row.className = open ? 'open' : '';
    row.dataset.sensor = alarm.sensor;
    const pill = document.createElement('span');
    pill.className = `pill ${open ? 'error' : 'stale'}`;
    pill.textContent = open ? '✕ ALARM' : 'over';
    const cells = [pill, alarm.sensor, alarm.kind, show(alarm.size), plain(alarm.bound),
      plain(alarm.confidence), time(alarm.onset), time(alarm.detected), time(alarm.ended)];
    cells.forEach((content, i) => {
      const cell = document.createElement('td');
      if (i > 2) cell.className = 'number';
      cell.append(content);
      row.append(cell);
    });
    return row;
  });
  if (!rows.length) {
    const row = document.createElement('tr'), cell = document.createElement('td');
    row.className = 'none';
    cell.colSpan = 9;
    cell.textContent = 'none';
    row.append(cell);
    rows.push(row);
  }
  byId('alarms').replaceChildren(...rows);
}
