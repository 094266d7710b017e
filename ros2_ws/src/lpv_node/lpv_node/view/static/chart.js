// Charts that scroll in time: lines with gaps, a band, shaded stretches.

import { line, surface, write } from '/theme.js';

const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 20, FONT = '11px system-ui, sans-serif';

export class Chart {
  // Series: {values: sample => number or null, colour, dash, width}; band and marks likewise.
  constructor(canvas, { series, band, marks, smallest, unit }) {
    Object.assign(this, { canvas, series, band, marks, smallest, unit });
    this.limit = smallest;
  }

  draw(samples, window) {
    const { context, width, height } = surface(this.canvas);
    const first = samples[0]?.t ?? 0, last = samples.at(-1)?.t ?? 0;
    const inner = { width: width - LEFT - RIGHT, height: height - TOP - BOTTOM };
    if (inner.width < 40 || inner.height < 40) return;
    const limit = this.range(samples);
    const x = (t) => LEFT + inner.width * (1 + (t - last) / window);
    const y = (v) => TOP + inner.height * (0.5 - v / (2 * limit));
    this.drawAxes(context, x, y, { last, window, limit, width, height: inner.height });
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP, inner.width, inner.height);
    context.clip();
    for (const [start, end] of this.marks?.() ?? []) {
      const [from, to] = [x(Math.max(start, first)), x(Math.min(end ?? last, last))];
      const [low, high] = [TOP + inner.height, TOP];
      if (to > from) {
        line(context, [[from, low], [from, high], [to, high], [to, low]],
          { fill: 'alarm', alpha: 0.14 });
      }
    }
    for (const run of this.band ? runs(samples, this.band) : []) {
      const side = (k) => run.map(([t, limits]) => [x(t), y(limits[k])]);
      line(context, [...side(1), ...side(0).reverse()], { fill: 'band' });
    }
    for (const { values, colour, dash, width: thick = 2 } of this.series) {
      for (const run of runs(samples, values)) {
        line(context, run.map(([t, v]) => [x(t), y(v)]), { stroke: colour, dash, width: thick });
      }
    }
    context.restore();
  }

  // Symmetric about zero; grows at once, shrinks slowly, in steps that keep the labels readable.
  range(samples) {
    let largest = this.smallest;
    for (const sample of samples) {
      for (const { values } of this.series) {
        largest = Math.max(largest, Math.abs(values(sample) ?? 0) * 1.12);
      }
    }
    this.limit = largest > this.limit ? largest : Math.max(largest, this.limit * 0.97);
    return this.limit;
  }

  drawAxes(context, x, y, { last, window, limit, width, height }) {
    const step = niceStep((limit * 44) / height);
    context.textAlign = 'right';
    context.textBaseline = 'middle';
    for (let k = -Math.floor(limit / step); k * step <= limit; k++) {
      const at = Math.round(y(k * step)) + 0.5;
      line(context, [[LEFT, at], [width - RIGHT, at]], { stroke: 'line', alpha: k === 0 ? 1 : 0.6 });
      write(context, label(k * step, step), LEFT - 6, at, FONT);
    }
    context.save();
    context.translate(10, y(0));
    context.rotate(-Math.PI / 2);
    context.textAlign = 'center';
    write(context, this.unit, 0, 0, FONT);
    context.restore();
    context.textBaseline = 'top';
    for (let ago = 0; ago <= window; ago += width < 420 ? 10 : 5) {
      context.textAlign = ago === 0 ? 'right' : ago === window ? 'left' : 'center';
      write(context, ago === 0 ? 'now' : `−${ago} s`, x(last - ago), y(-limit) + 5, FONT);
    }
  }
}

// Stretches without gaps, of pairs of time and what `value` gives for a sample.
function runs(samples, value) {
  const found = [[]];
  for (const sample of samples) {
    const one = value(sample);
    if (one != null) found.at(-1).push([sample.t, one]);
    else if (found.at(-1).length) found.push([]);
  }
  return found.filter((run) => run.length > 1);
}

function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= rough) ?? 10 * power;
}

function label(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return (value === 0 ? 0 : value).toFixed(Math.min(digits, 4)).replace('-', '−');
}
