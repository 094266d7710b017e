// The live view: takes frames from the node, keeps a short history, draws.

import { ArmDrawing } from '/arm.js';
import { Chart } from '/chart.js';
import { Link } from '/link.js';
import { byId, make, showAlarms, showFrame, showLink } from '/panels.js';
import { startTheme } from '/theme.js';

const FIELDS = {
  bias: { size: 0.3 }, drift: { size: 0.25, rate: 0.08 }, scale: { size: 0.2 }, stuck: {},
  noise: { size: 0.05 }, spike: { size: 0.5, rate: 2 }, dropout: {},
  rate_bias: { size: 0.3 },
};
const LABELS = { size: { drift: 'Up to [unit], 0: no end', scale: 'Factor minus 1',
  rate_bias: 'Size [unit/s]' },
  rate: { drift: 'Rate [unit/s]', spike: 'Spikes a second' } };

const DASHES = [[], [7, 4], [2, 3], [12, 4], [7, 3, 2, 3], [3, 6], [14, 3, 3, 3]];

let hello = null, frame = null, samples = [], alarms = [], waiting = false, token = null;
const arm = new ArmDrawing(byId('arm'));
let charts = [];
const sensorChart = (canvas, i, unit) => new Chart(canvas, {
  unit, smallest: 0.01,
  series: [
    { values: (s) => s.threshold[i], colour: 'threshold', dash: [6, 5], width: 1.5 },
    { values: (s) => s.threshold[i] && -s.threshold[i], colour: 'threshold', dash: [6, 5],
      width: 1.5 },
    { values: (s) => s.fault[i], colour: 'true', dash: [2, 4], width: 2.5 },
    { values: (s) => s.estimate[i], colour: 'estimated' }],
  band: (s) => (s.estimate[i] == null || s.bound[i] == null ? null
    : [s.estimate[i] - s.bound[i], s.estimate[i] + s.bound[i]]),
  marks: () => alarms.filter((row) => row.sensor === hello?.sensors[i] && !row.past)
    .map((row) => [row.detected, row.ended]),
});
const torqueChart = (units) => new Chart(byId('torque'), {
  unit: [...new Set(units)].join(', '), smallest: 1,
  series: units.map((_, i) => ({ values: (s) => s.torque[i], colour: `torque${i % 2}`,
    dash: DASHES[i % DASHES.length] })),
});

// One card and one chart for each sensor, one line for each joint.
function layOut({ sensors, joints, units }) {
  const cards = sensors.map((name, i) => {
    const card = byId('sensor-card').content.firstElementChild.cloneNode(true);
    card.id = `sensor-${i}`;
    card.querySelector('h2').textContent = name;
    return card;
  });
  byId('sensors').replaceChildren(...cards);
  byId('sensors').classList.toggle('many', sensors.length > 2);
  byId('joints').replaceChildren(...joints.map((name, i) => make('li', '', lineKey(i), name)));
  charts = cards.map((card, i) => sensorChart(card.querySelector('canvas'), i, units[i][0]));
  charts.push(torqueChart(units.map(([, unit]) => unit)));
}

// A piece of a joint's line, for the legend.
function lineKey(i) {
  const create = (tag) => document.createElementNS('http://www.w3.org/2000/svg', tag);
  const key = create('svg'), path = create('path');
  key.setAttribute('class', `line-key torque${i % 2}`);
  path.setAttribute('d', 'M0 2H34');
  path.setAttribute('stroke-dasharray', DASHES[i % DASHES.length].join(' ') || 'none');
  key.append(path);
  return key;
}

function draw() {
  waiting = false;
  if (!hello) return;
  if (frame) showFrame(frame, alarms, hello);
  arm.draw(frame);
  for (const chart of charts) chart.draw(samples, hello.window);
}

function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(draw);
}

function start(message) {
  hello = message;
  samples = message.history;
  byId('arm-name').textContent = message.arm;
  document.title = `${message.arm}, live`;
  layOut(message);
  byId('key-path').hidden = !message.scene.path.length;
  options(byId('sensor'), message.sensors);
  // A connection that comes back leaves the form as it is.
  const known = options(byId('kind'), message.kinds);
  byId('token-form').hidden = !message.token_needed || token != null;
  arm.start(message);
  (known ? showLabels : showFields)();
  takeAlarms(message.alarms);
}

function options(select, names) {
  const chosen = select.value;
  select.replaceChildren(...names.map((name) => new Option(name, name)));
  const known = names.includes(chosen);
  if (known) select.value = chosen;
  return known;
}

// Without a link nothing is known of the present: neither a verdict is given nor an arm drawn.
function takeLink(state) {
  const lost = state !== 'connected';
  showLink(state);
  document.body.classList.toggle('lost', lost);
  if (!lost) return;
  frame = null;
  takeServices({});
  redraw();
}

function takeServices(there) {
  for (const name of ['inject', 'clear', 'reset']) byId(name).disabled = !there[name];
}

function takeFrame(message) {
  frame = message;
  const { sample } = message;
  const last = samples.at(-1)?.t;
  if (sample.t != null && sample.t !== last) {
    if (last != null && sample.t < last - 1) samples = [];  // time started anew
    samples.push(sample);
    while (samples.length > 4000 || samples[0].t < sample.t - hello.window) samples.shift();
  }
  const { inject, clear } = message.services;
  takeServices(message.services);
  byId('no-simulator').hidden = inject || clear;
}

function takeAlarms(rows) {
  alarms = rows;
  showAlarms(rows, hello);
  const open = rows.filter((row) => row.ended == null).length;
  document.title = `${open ? `(${open} ALARM) ` : ''}${hello.arm}, live`;
}

// A token in the link's fragment never leaves the browser; it is kept in this tab's memory only.
const given = new URLSearchParams(location.hash.slice(1)).get('token');
if (given) {
  token = given;
  history.replaceState(null, '', location.pathname);
}
const link = new Link((message) => {
  if (message.type === 'hello') start(message);
  else if (message.type === 'frame' && hello) takeFrame(message);
  else if (message.type === 'alarms' && hello) takeAlarms(message.alarms);
  else if (message.type === 'error') say(message.message, true);
  redraw();
}, (state) => {
  takeLink(state);
  if (state === 'connected' && token) unlock(token);
});

function say(text, bad = false) {
  byId('reply').textContent = text;
  byId('reply').classList.toggle('bad', bad);
}

function ask(fields) {
  say('…');
  link.send(fields).then((text) => say(text), (error) => say(error.message, true));
}

function showFields() {
  const kind = byId('kind').value, fields = FIELDS[kind] ?? { size: 0, rate: 0 };
  for (const name of ['size', 'rate']) {
    document.querySelector(`[data-field=${name}]`).hidden = !(name in fields);
    byId(name).value = fields[name] ?? 0;
  }
  showLabels();
}

function showLabels() {
  const [unit] = hello.units[byId('sensor').selectedIndex];
  for (const name of ['size', 'rate']) {
    const label = LABELS[name][byId('kind').value] ?? 'Size [unit]';
    byId(`${name}-label`).textContent = label.replace('unit', unit);
  }
}

function unlock(attempt) {
  link.send({ type: 'token', token: attempt }).then((text) => {
    token = attempt;
    byId('token-form').hidden = true;
    say(text);
  }, (error) => {
    token = null;
    byId('token-form').hidden = !hello?.token_needed;
    say(error.message, true);
  });
}

byId('kind').addEventListener('change', showFields);
byId('sensor').addEventListener('change', showLabels);
byId('fault-form').addEventListener('submit', (event) => {
  event.preventDefault();
  const number = (id) => Number(byId(id).value) || 0;
  ask({ type: 'inject', sensor: byId('sensor').value, kind: byId('kind').value,
    size: number('size'), rate: number('rate'), duration: number('duration') });
});
byId('clear').addEventListener('click', () => ask({ type: 'clear', sensor: '' }));
byId('reset').addEventListener('click', () => ask({ type: 'reset' }));
byId('token-form').addEventListener('submit', (event) => {
  event.preventDefault();
  unlock(byId('token').value.trim());
  byId('token').value = '';
});
startTheme(draw);
addEventListener('resize', redraw);
