// Dark or light, as the system has it until the user chooses; canvases read their colours here.

const root = document.documentElement;
const system = matchMedia('(prefers-color-scheme: dark)');
const button = document.getElementById('theme');
let chosen = null, colours = null, changed = () => {};

function stored() {
  try { return localStorage.getItem('theme'); } catch { return null; }
}

function apply(theme = chosen ?? (system.matches ? 'dark' : 'light')) {
  root.dataset.theme = theme;
  button.textContent = theme === 'dark' ? 'Light' : 'Dark';
  button.setAttribute('aria-label', `Switch to the ${theme === 'dark' ? 'light' : 'dark'} theme`);
  colours = null;
  changed();
}

function colour(name) {
  if (!colours) {
    const style = getComputedStyle(root);
    colours = Object.fromEntries(['text', 'soft', 'line', 'card', 'true', 'estimated', 'measured',
      'band', 'threshold', 'alarm', 'torque0', 'torque1']
      .map((key) => [key, style.getPropertyValue(`--${key}`).trim()]));
  }
  return colours[name];
}

export function startTheme(onChange) {
  changed = onChange;
  chosen = stored();
  button.addEventListener('click', () => {
    chosen = root.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('theme', chosen); } catch { /* private windows forget it */ }
    apply();
  });
  system.addEventListener('change', () => apply());
  addEventListener('beforeprint', () => apply('light'));
  addEventListener('afterprint', () => apply());
  apply();
}

// A canvas in device pixels, ready to draw in CSS pixels.
export function surface(canvas) {
  const ratio = devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext('2d');
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

function paint(context, { stroke, fill, width = 1, dash = [], alpha = 1, cap = 'butt' }) {
  context.globalAlpha = alpha;
  if (fill) {
    context.fillStyle = colour(fill);
    context.fill();
  }
  if (stroke) {
    Object.assign(context, { strokeStyle: colour(stroke), lineWidth: width, lineJoin: 'round',
      lineCap: cap });
    context.setLineDash(dash);
    context.stroke();
  }
  context.globalAlpha = 1;
}

export function line(context, points, style) {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  paint(context, style);
}

export function disc(context, [x, y], radius, style) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  paint(context, style);
}

export function write(context, text, x, y, font) {
  context.font = font;
  context.fillStyle = colour('soft');
  context.fillText(text, x, y);
}
