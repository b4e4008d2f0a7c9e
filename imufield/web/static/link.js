// The connection to the program: opened with the token of the address, opened again for as long as the page lives.

const SOCKET = "/socket";
const SHORTEST_MS = 250;
const LONGEST_MS = 4000;
const SILENT_MS = 3000; // The program says something once a second, if only a beat: {}.

/** Whether an address is one of this machine: others may come from anybody. @param {string} url */
export const isOfThisMachine = (url) => /^http:\/\/(127\.0\.0\.1|localhost|\[::1\]):\d+\//.test(url);

/** @param {string} hash */
const tokenOf = (hash) => new URLSearchParams(hash.slice(1)).get("token");

/**
 * Take the token out of the address, where nobody shall read it off the screen; a reload finds it in this tab's memory.
 * @returns {string}
 */
function token() {
  const given = tokenOf(location.hash);
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return given || sessionStorage.getItem("token") || "";
}

// Typed into the tab of an earlier page, an address with another token loads nothing by itself. It is that of the event: who
// chose a tab of the page meanwhile has another one in the address already.
addEventListener("hashchange", (event) => {
  const given = tokenOf(new URL(event.newURL).hash);
  if (!given) return;
  sessionStorage.setItem("token", given);
  location.reload();
});

export class Link {
  /**
   * @param {(message: any) => void} onMessage
   * @param {(isThere: boolean) => void} onChange
   */
  constructor(onMessage, onChange) {
    this.onMessage = onMessage;
    this.onChange = onChange;
    this.token = token();
    /** @type {WebSocket | null} */
    this.socket = null;
    this.waitMs = SHORTEST_MS;
    this.timer = 0;
    this.heardMs = 0; // By the clock of the day: others stand still while a phone sleeps.
    // Without a token nobody gets in, however often it is tried.
    this.ended = !this.token;
    if (this.token) this.open();
    else queueMicrotask(() => onChange(false));
    // A phone that slept, or has another network, finds its socket dead at once and not after minutes.
    for (const event of ["online", "pageshow", "focus"]) addEventListener(event, () => this.check());
    document.addEventListener("visibilitychange", () => this.check());
    setInterval(() => this.check(), 1000);
  }

  open() {
    clearTimeout(this.timer);
    this.timer = 0;
    const socket = new WebSocket(`ws://${location.host}${SOCKET}`, ["imufield", `token.${this.token}`]);
    this.socket = socket;
    this.heardMs = Date.now();
    socket.onmessage = (event) => {
      if (socket !== this.socket) return;
      if (this.waitMs) this.onChange(true);
      this.waitMs = 0;
      this.heardMs = Date.now();
      const message = JSON.parse(event.data);
      // What let this page in lets nobody in again.
      if (message.token) sessionStorage.setItem("token", (this.token = message.token));
      if (Object.keys(message).length) this.onMessage(message);
    };
    socket.onclose = () => {
      if (socket === this.socket) this.again();
    };
  }

  again() {
    this.socket = null;
    if (this.ended) return;
    this.onChange(false);
    this.waitMs = Math.min(Math.max(2 * this.waitMs, SHORTEST_MS), LONGEST_MS);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.open(), this.waitMs);
  }

  check() {
    if (document.hidden || this.ended) return;
    if (!this.socket) {
      if (this.waitMs > SHORTEST_MS) {
        this.waitMs = SHORTEST_MS;
        this.open();
      }
    } else if (Date.now() - this.heardMs > SILENT_MS) {
      const old = this.socket;
      this.again();
      old.close();
    }
  }

  /** The program has said its last words: nothing is tried any more. */
  end() {
    this.ended = true;
  }

  /** @param {string | Uint8Array<ArrayBuffer>} message @returns {boolean} whether it was sent */
  send(message) {
    const isOpen = this.socket?.readyState === WebSocket.OPEN;
    if (isOpen) this.socket?.send(message);
    return isOpen;
  }
}
