// A browser as far as the live page needs one: takes steps from standard input, tells what is shown.

import { readFileSync } from 'node:fs';

class Element {
  constructor(tag = '', value = '') {
    Object.assign(this, { tag, dataset: {}, style: {}, attributes: {}, handlers: {}, parts: {},
      children: [], own: '', className: '', hidden: false, disabled: false, calls: [] });
    if (value) this.value = value;
    Object.assign(this, { clientWidth: 400, clientHeight: 300 });
  }

  get textContent() {
    return this.own + [...this.children, ...Object.values(this.parts)]
      .map((child) => child.textContent ?? child).join(' ');
  }

  set textContent(text) { this.own = String(text); this.children = []; }
  get value() { return this.chosen ?? this.children[0]?.value ?? ''; }
  set value(value) { this.chosen = String(value); }
  get selectedIndex() { return this.children.findIndex(({ value }) => value === this.value); }
  get content() { return this; }
  get firstElementChild() { return this; }
  get firstChild() { return this.children[0]; }

  get classList() {
    const names = this.className.split(' ');
    return { contains: (name) => names.includes(name), toggle: (name, on) => {
      this.className = [...names.filter((one) => one !== name), ...(on ? [name] : [])].join(' ');
    } };
  }

  append(...content) { this.children.push(...content); }
  replaceChildren(...content) { Object.assign(this, { children: content, own: '', chosen: null }); }
  setAttribute(name, value) { this.attributes[name] = value; }
  addEventListener(type, handler) { this.handlers[type] = handler; }
  cloneNode() { return new Element(this.tag); }
  querySelector(selector) { return (this.parts[selector] ??= new Element()); }

  getContext() {
    return new Proxy({}, { get: (_, name) => (...values) => this.calls.push([name, ...values]),
      set: () => true });
  }
}

class Socket {
  static OPEN = 1;
  constructor() { this.readyState = 0; this.sent = []; sockets.push(this); }
  send(text) { this.sent.push(text); }
  close() { this.readyState = 2; }
}

const sockets = [], waiting = [], ids = {}, shown = [];
let clock = 0;
const wait = (every) => (handler, pause) => waiting.push({ handler, at: clock + pause, pause, every });
const byId = (id) => (ids[id] ??= new Element());
const root = new Element(), body = new Element(), form = new Element();
Object.assign(globalThis, {
  document: { documentElement: root, body, title: '', getElementById: byId,
    createElement: (tag) => new Element(tag), createElementNS: (_, tag) => new Element(tag),
    querySelector: (selector) => form.querySelector(selector) },
  location: { protocol: 'http:', host: 'here', hash: '', pathname: '/' },
  history: { replaceState() {} }, localStorage: { getItem: () => null, setItem() {} },
  matchMedia: () => new Element(), getComputedStyle: () => ({ getPropertyValue: () => 'black' }),
  Option: class extends Element { constructor(text, value) { super('', value); this.own = text; } },
  addEventListener: (type, handler) => byId('window').addEventListener(type, handler),
  WebSocket: Socket, devicePixelRatio: 1, setInterval: wait(true), setTimeout: wait(false),
  requestAnimationFrame: wait(false), performance: { now: () => clock },
});

function pass(time) {
  for (const end = clock + time; clock < end; clock += 100) {
    for (const one of waiting.filter(({ at }) => !(at > clock))) {
      if (one.every) one.at += one.pause;
      else waiting.splice(waiting.indexOf(one), 1);
      one.handler();
    }
  }
}

const steps = {
  open() { sockets.at(-1).readyState = 1; sockets.at(-1).onopen(); },
  take(message) { sockets.at(-1).onmessage({ data: JSON.stringify(message) }); pass(100); },
  close() { sockets.at(-1).onclose(); },
  pass,
  fire(id, type) { byId(id).handlers[type]({ preventDefault() {} }); },
  set(id, value) { byId(id).value = value; },
  show(id, name = 'textContent') { shown.push(JSON.parse(JSON.stringify(byId(id)[name]))); },
  sockets() { shown.push(sockets.length); },
};
await import('./view.js');
for (const [name, ...values] of JSON.parse(readFileSync(0, 'utf8'))) steps[name](...values);
console.log(JSON.stringify(shown));
