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

export function colour(name) {
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
