// The arm, drawn from the corners of its links: true, estimated, measured.

import { colour, surface } from '/theme.js';

const STYLES = {
  true: { width: 17, dash: [], alpha: 0.35, dot: 10 },
  estimated: { width: 7, dash: [], alpha: 1, dot: 7 },
  measured: { width: 2.5, dash: [7, 6], alpha: 1, dot: 4 },
};

export class ArmDrawing {
  constructor(canvas) {
    this.canvas = canvas;
    this.hello = null;
    this.box = null;
  }

  start(hello) {
    this.hello = hello;
    this.reach = hello.reach;
    // Fractions of the reach that are shown to the sides, below and above.
    this.box = { side: 0.55, low: 0.2, high: 0.2 };
    const { path, obstacle } = hello.scene;
    path.forEach((point) => this.include(point));
    if (obstacle) {
      const [x, y] = obstacle.center, r = obstacle.radius;
      [[x - r, y - r], [x + r, y + r]].forEach((point) => this.include(point));
    }
  }

  include([x, y]) {
    const { box, reach } = this;
    box.side = Math.max(box.side, Math.abs(x) / reach + 0.06);
    box.high = Math.max(box.high, y / reach + 0.06);
    box.low = Math.max(box.low, -y / reach + 0.06);
  }

  draw(frame) {
    if (!this.hello) return;
    const { context, width, height } = surface(this.canvas);
    const arms = Object.entries(frame?.arms ?? {}).filter(([, corners]) => corners)
      .map(([name, corners]) => [name, corners.map(flat)]);
    const place = this.fit(arms, width, height);
    this.drawGround(context, place, width);
    const tip = frame?.sample?.tip;
    this.drawScene(context, place, tip?.[0] == null ? null : flat(tip));
    for (const name of ['true', 'estimated', 'measured']) {
      const found = arms.find(([other]) => other === name);
      if (found) this.drawArm(context, found[1].map(place), name);
    }
    this.drawBase(context, place([0, 0]));
  }

  // Shows what the arm has needed so far: the picture grows, and never jumps back.
  fit(arms, width, height) {
    for (const [, corners] of arms) corners.forEach((corner) => this.include(corner));
    const { side, low, high } = this.box, { reach } = this;
    const scale = Math.min(width / (2 * side), height / (low + high)) / reach;
    const middle = (height - (low + high) * reach * scale) / 2;
    return ([x, y]) => [width / 2 + x * scale, middle + (high * reach - y) * scale];
  }

  drawGround(context, place, width) {
    const [, y] = place([0, 0]);
    context.strokeStyle = colour('line');
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(0, y);
    context.lineTo(width, y);
    context.stroke();
    context.fillStyle = context.strokeStyle = colour('soft');
    const x = width - 22;
    line(context, [[x, y - 52], [x, y - 24]]);
    line(context, [[x - 4, y - 30], [x, y - 23], [x + 4, y - 30]]);
    context.font = 'italic 13px serif';
    context.fillText('g', x + 8, y - 34);
  }

  drawScene(context, place, tip) {
    const { path, obstacle } = this.hello.scene;
    if (obstacle) {
      const [x, y] = place(obstacle.center), [edge] = place([obstacle.center[0] + obstacle.radius, 0]);
      context.beginPath();
      context.arc(x, y, edge - x, 0, 2 * Math.PI);
      context.fillStyle = colour('alarm');
      context.globalAlpha = 0.2;
      context.fill();
      context.globalAlpha = 1;
      context.strokeStyle = colour('alarm');
      context.stroke();
    }
    context.strokeStyle = colour('soft');
    context.lineWidth = 1.3;
    if (path.length) {
      line(context, path.map(place));
    }
    if (tip?.[0] != null) {
      const [x, y] = place(tip);
      context.lineWidth = 2;
      line(context, [[x - 8, y], [x + 8, y]]);
      line(context, [[x, y - 8], [x, y + 8]]);
    }
  }

  drawArm(context, corners, name) {
    const style = STYLES[name];
    context.globalAlpha = style.alpha;
    context.strokeStyle = colour(name);
    context.lineWidth = style.width;
    context.lineCap = context.lineJoin = 'round';
    context.setLineDash(style.dash);
    line(context, corners);
    context.setLineDash([]);
    for (const [x, y] of corners.slice(1)) {
      context.beginPath();
      context.arc(x, y, style.dot, 0, 2 * Math.PI);
      context.fillStyle = name === 'true' ? colour(name) : colour('card');
      context.fill();
      context.lineWidth = 2.5;
      if (name !== 'true') context.stroke();
    }
    context.globalAlpha = 1;
  }

  drawBase(context, [x, y]) {
    context.fillStyle = colour('soft');
    context.beginPath();
    context.moveTo(x - 16, y + 18);
    context.lineTo(x - 9, y);
    context.arc(x, y, 9, Math.PI, 0);
    context.lineTo(x + 16, y + 18);
    context.fill();
    context.beginPath();
    context.arc(x, y, 4, 0, 2 * Math.PI);
    context.fillStyle = colour('card');
    context.fill();
  }
}

// A point of the plane as it is; one of space (x, y, z up) as seen from the front right, from above.
function flat(point) {
  if (point.length < 3) return point;
  const [x, y, z] = point, turn = Math.PI / 5, tilt = Math.PI / 9;
  const side = x * Math.cos(turn) - y * Math.sin(turn), depth = x * Math.sin(turn) + y * Math.cos(turn);
  return [side, z * Math.cos(tilt) + depth * Math.sin(tilt)];
}

function line(context, points) {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
}
