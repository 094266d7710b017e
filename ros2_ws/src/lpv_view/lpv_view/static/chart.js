// Charts that scroll in time: lines with gaps, a band, shaded stretches.

import { colour, surface } from '/theme.js';

const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 20;

export class Chart {
  // Series: {values: sample => number or null, colour, dash, width}; band and marks likewise.
  constructor(canvas, { series, band, marks, smallest, unit }) {
    Object.assign(this, { canvas, series, band, marks, smallest, unit });
    this.limit = smallest;
  }

  draw(samples, window) {
    const { context, width, height } = surface(this.canvas);
    const last = samples.length ? samples[samples.length - 1].t : 0;
    const inner = { width: width - LEFT - RIGHT, height: height - TOP - BOTTOM };
    if (inner.width < 40 || inner.height < 40) return;
    const limit = this.range(samples);
    const x = (t) => LEFT + inner.width * (1 + (t - last) / window);
    const y = (v) => TOP + inner.height * (0.5 - v / (2 * limit));
    this.drawAxes(context, x, y, last, window, limit, width, inner.height);
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP, inner.width, inner.height);
    context.clip();
    if (this.marks) this.drawMarks(context, samples, x, inner);
    if (this.band) this.drawBand(context, samples, x, y);
    for (const one of this.series) this.drawLine(context, samples, one, x, y);
    context.restore();
  }

  // Symmetric about zero; grows at once, shrinks slowly, in steps that keep the labels readable.
  range(samples) {
    let largest = this.smallest;
    for (const sample of samples) {
      for (const { values } of this.series) {
        const value = values(sample);
        if (value != null) largest = Math.max(largest, Math.abs(value) * 1.12);
      }
    }
    this.limit = largest > this.limit ? largest : Math.max(largest, this.limit * 0.97);
    return this.limit;
  }

  drawAxes(context, x, y, last, window, limit, width, height) {
    context.font = '11px system-ui, sans-serif';
    context.lineWidth = 1;
    context.textAlign = 'right';
    context.textBaseline = 'middle';
    const step = niceStep((limit * 44) / height);
    for (let k = -Math.floor(limit / step); k * step <= limit; k++) {
      const at = Math.round(y(k * step)) + 0.5;
      context.strokeStyle = colour('line');
      context.globalAlpha = k === 0 ? 1 : 0.6;
      context.beginPath();
      context.moveTo(LEFT, at);
      context.lineTo(width - RIGHT, at);
      context.stroke();
      context.globalAlpha = 1;
      context.fillStyle = colour('soft');
      context.fillText(label(k * step, step), LEFT - 6, at);
    }
    context.save();
    context.translate(10, y(0));
    context.rotate(-Math.PI / 2);
    context.textAlign = 'center';
    context.fillText(this.unit, 0, 0);
    context.restore();
    context.textBaseline = 'top';
    const apart = width < 420 ? 10 : 5;
    for (let ago = 0; ago <= window; ago += apart) {
      context.textAlign = ago === 0 ? 'right' : ago === window ? 'left' : 'center';
      const at = y(-limit) + 5;
      context.fillText(ago === 0 ? 'now' : `−${ago} s`, x(last - ago), at);
    }
  }

  drawLine(context, samples, { values, colour: name, dash = [], width = 2 }, x, y) {
    context.strokeStyle = colour(name);
    context.lineWidth = width;
    context.lineJoin = 'round';
    context.setLineDash(dash);
    context.beginPath();
    let drawing = false;
    for (const sample of samples) {
      const value = values(sample);
      if (value == null) { drawing = false; continue; }
      if (drawing) context.lineTo(x(sample.t), y(value));
      else context.moveTo(x(sample.t), y(value));
      drawing = true;
    }
    context.stroke();
    context.setLineDash([]);
  }

  drawBand(context, samples, x, y) {
    context.fillStyle = colour('band');
    let run = [];
    const fill = () => {
      if (run.length > 1) {
        context.beginPath();
        run.forEach(([t, , high]) => context.lineTo(x(t), y(high)));
        run.reverse().forEach(([t, low]) => context.lineTo(x(t), y(low)));
        context.fill();
      }
      run = [];
    };
    for (const sample of samples) {
      const limits = this.band(sample);
      if (limits) run.push([sample.t, ...limits]);
      else fill();
    }
    fill();
  }

  drawMarks(context, samples, x, inner) {
    context.fillStyle = colour('alarm');
    context.globalAlpha = 0.14;
    const first = samples.length ? samples[0].t : 0, last = samples.at(-1)?.t ?? 0;
    for (const [start, end] of this.marks()) {
      const from = x(Math.max(start, first)), to = x(Math.min(end ?? last, last));
      if (to > from) context.fillRect(from, TOP, to - from, inner.height);
    }
    context.globalAlpha = 1;
  }
}

function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= rough) ?? 10 * power;
}

function label(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return (value === 0 ? 0 : value).toFixed(Math.min(digits, 4)).replace('-', '−');
}
