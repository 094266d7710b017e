// The arm, drawn from the corners of its links: true, estimated, measured.

import { disc, line, surface, write } from '/theme.js';

const STYLES = {
  true: { width: 17, alpha: 0.35, dot: 10 },
  estimated: { width: 7, dot: 7 },
  measured: { width: 2.5, dash: [7, 6], dot: 4 },
};

export class ArmDrawing {
  constructor(canvas) {
    this.canvas = canvas;
    this.hello = null;
  }

  start(hello) {
    this.hello = hello;
    // Fractions of the reach that are shown to the sides, below and above.
    this.box = { side: 0.55, low: 0.2, high: 0.2 };
    const { path, obstacle } = hello.scene;
    this.path = path.map(flat);
    this.path.forEach((point) => this.include(point));
    for (const r of obstacle ? [obstacle.radius, -obstacle.radius] : []) {
      this.include(obstacle.center.map((v) => v + r));
    }
  }

  // A point that is within reach of the arm, or nearly: wild readings must not shrink the picture.
  include(point) {
    const { box, hello: { reach } } = this;
    const [x, y] = point.map((v) => Math.max(-1.5, Math.min(1.5, v / reach)));
    box.side = Math.max(box.side, Math.abs(x) + 0.06);
    box.high = Math.max(box.high, y + 0.06);
    box.low = Math.max(box.low, -y + 0.06);
  }

  draw(frame) {
    if (!this.hello) return;
    const { context, width, height } = surface(this.canvas), arms = {};
    for (const [name, corners] of Object.entries(frame?.arms ?? {})) {
      if (corners) arms[name] = corners.map(flat);
    }
    // Shows what the arm has needed so far: the picture grows, and never jumps back.
    Object.values(arms).forEach((corners) => corners.forEach((corner) => this.include(corner)));
    const { side, low, high } = this.box, { reach, scene } = this.hello;
    const scale = Math.min(width / (2 * side), height / (low + high)) / reach;
    const middle = (height - (low + high) * reach * scale) / 2;
    const place = ([x, y]) => [width / 2 + x * scale, middle + (high * reach - y) * scale];
    const base = place([0, 0]), tip = frame?.sample?.tip;
    drawGround(context, base[1], width);
    if (scene.obstacle) {
      const [radius, at] = [scene.obstacle.radius * scale, place(scene.obstacle.center)];
      disc(context, at, radius, { fill: 'alarm', alpha: 0.2 });
      disc(context, at, radius, { stroke: 'alarm' });
    }
    if (this.path.length) line(context, this.path.map(place), { stroke: 'soft', width: 1.3 });
    if (tip?.[0] != null) {
      const [x, y] = place(flat(tip)), cross = { stroke: 'soft', width: 2 };
      line(context, [[x - 8, y], [x + 8, y]], cross);
      line(context, [[x, y - 8], [x, y + 8]], cross);
    }
    for (const name of Object.keys(STYLES)) {
      if (arms[name]) drawArm(context, arms[name].map(place), name, STYLES[name]);
    }
    drawBase(context, base);
  }
}

function drawGround(context, y, width) {
  const x = width - 22, arrow = { stroke: 'soft' };
  line(context, [[0, y], [width, y]], { stroke: 'line' });
  line(context, [[x, y - 52], [x, y - 24]], arrow);
  line(context, [[x - 4, y - 30], [x, y - 23], [x + 4, y - 30]], arrow);
  context.textAlign = 'start';
  write(context, 'g', x + 8, y - 34, 'italic 13px serif');
}

function drawArm(context, corners, name, { dot, ...style }) {
  line(context, corners, { stroke: name, cap: 'round', ...style });
  for (const corner of corners.slice(1)) {
    disc(context, corner, dot, name === 'true' ? { fill: name, alpha: style.alpha }
      : { fill: 'card', stroke: name, width: 2.5 });
  }
}

function drawBase(context, [x, y]) {
  line(context, [[x - 16, y + 18], [x - 9, y], [x + 9, y], [x + 16, y + 18]], { fill: 'soft' });
  disc(context, [x, y], 9, { fill: 'soft' });
  disc(context, [x, y], 4, { fill: 'card' });
}

// A point of the plane as it is; one of space (x, y, z up) as seen from the front right, from above.
function flat(point) {
  if (point.length < 3) return point;
  const [x, y, z] = point, turn = Math.PI / 5, tilt = Math.PI / 9;
  const side = x * Math.cos(turn) - y * Math.sin(turn), depth = x * Math.sin(turn) + y * Math.cos(turn);
  return [side, z * Math.cos(tilt) + depth * Math.sin(tilt)];
}
