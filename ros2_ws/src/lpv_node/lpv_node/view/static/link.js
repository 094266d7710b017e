// The WebSocket to the node: reconnects by itself, answers each request once.

const SHORTEST = 500, LONGEST = 5000, SILENCE = 4000;

export class Link {
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.pause = SHORTEST;
    this.number = 0;
    this.waiting = new Map();
    this.heard = 0;
    setInterval(() => this.check(), 1000);
    this.open();
  }

  open() {
    const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
    const socket = new WebSocket(`${scheme}//${location.host}/ws`);
    this.socket = socket;
    this.heard = performance.now();
    socket.onopen = () => {
      this.pause = SHORTEST;
      this.onState('connected');
    };
    socket.onmessage = (event) => {
      this.heard = performance.now();
      const message = JSON.parse(event.data);
      if (message.type === 'reply') this.settle(message);
      else this.onMessage(message);
    };
    socket.onclose = () => this.lose(socket);
  }

  lose(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    for (const [, { reject }] of this.waiting) reject(new Error('the connection was lost'));
    this.waiting.clear();
    this.onState('reconnecting');
    setTimeout(() => this.open(), this.pause * (0.8 + 0.4 * Math.random()));
    this.pause = Math.min(LONGEST, this.pause * 1.6);
  }

  // A connection that died without a word is not waited for: its close may take minutes.
  check() {
    const { socket } = this;
    if (!socket || performance.now() - this.heard < SILENCE) return;
    socket.close();
    this.lose(socket);
  }

  settle(reply) {
    const promise = this.waiting.get(reply.id);
    if (!promise) return;
    this.waiting.delete(reply.id);
    if (reply.ok) promise.resolve(reply.message);
    else promise.reject(new Error(reply.message));
  }

  send(fields) {
    if (this.socket?.readyState !== WebSocket.OPEN) {
      return Promise.reject(new Error('not connected'));
    }
    const id = ++this.number;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.socket.send(JSON.stringify({ ...fields, id }));
    });
  }
}
