// What the page knows: the commands that were started, what they said, and how to ask for more.

import { Link } from "./link.js";
import { text } from "./texts.js";

const PIECE = 400000; // Bytes of a file in one message; the program takes half a mebibyte.
const ID = 16;

/**
 * @typedef {object} Job
 * @property {number} job
 * @property {string} action
 * @property {any} values
 * @property {string} command
 * @property {string[]} said lines of standard error
 * @property {string[]} lines words of standard output
 * @property {any[]} found values of standard output
 * @property {Record<string, any>} told the newest of these of each event, the very newest last
 * @property {number | null} code
 */

export class Bench {
  /** @param {() => void} onChange */
  constructor(onChange) {
    this.onChange = onChange;
    /** @type {Map<number, Job>} */
    this.jobs = new Map();
    /** @type {any} the folder of sessions, what parts its paths, the name of a virtual instrument in it */
    this.head = { root: "", separator: "/", virtual: "" };
    this.isThere = false;
    this.isUnknown = false; // The program is there, and lets this page in no more.
    this.asked = 0;
    /** @type {Map<number, {resolve: (answer: any) => void, reject: (error: Error) => void}>} */
    this.waiting = new Map();
    /** @type {Map<string, (answer: any) => void>} */
    this.pieces = new Map();
    /** @type {string[]} what was asked before the connection was there */
    this.unsent = [];
    /** @type {{number: number, resolve: (job: Job) => void, reject: (error: Error) => void}[]} */
    this.awaited = [];
    this.link = new Link(
      (message) => this.take(message),
      (isThere) => {
        if (!isThere && !this.isThere) void this.askWhetherUnknown();
        this.isThere = isThere;
        if (isThere) for (const text of this.unsent.splice(0)) this.link.send(text);
        else this.fail(text("gone"));
        onChange();
      },
    );
  }

  /** A socket that does not open tells no cause: whether the program is there its files say. */
  async askWhetherUnknown() {
    this.isUnknown = await fetch("/texts.js").then(
      () => !this.isThere,
      () => false,
    );
    this.onChange();
  }

  /** @param {string} words */
  fail(words) {
    for (const { reject } of this.waiting.values()) reject(new Error(words));
    this.waiting.clear();
    this.unsent = [];
    for (const take of this.pieces.values()) take({ refused: words });
    this.pieces.clear();
  }

  /** @param {any} message */
  take(message) {
    if ("answer" in message || "refused" in message) {
      this.answer(message);
      return;
    }
    if (message.head) {
      this.head = message.head;
      this.jobs.clear();
    }
    for (const event of message.log ?? []) {
      this.know(event);
      const job = this.jobs.get(event.job);
      if (!job) continue;
      if ("said" in event) job.said.push(event.said);
      if ("line" in event) job.lines.push(event.line);
      if ("value" in event) job.found.push(event.value);
      if (event.value?.event) {
        const { [event.value.event]: _, ...others } = job.told;
        job.told = { ...others, [event.value.event]: event.value };
      }
      if ("code" in event) job.code = event.code;
    }
    // The log is cut; of those that run all is known.
    for (const head of message.state?.running ?? []) this.know(head).told = head.told;
    if (!message.state) return;
    this.awaited = this.awaited.filter(({ number, resolve, reject }) => {
      const job = this.jobs.get(number);
      if (!job) reject(new Error(text("gone")));
      else if (job.code !== null) resolve(job);
      return job?.code === null;
    });
    this.onChange();
  }

  /** @param {any} head @returns {any} */
  know(head) {
    if (head.action && !this.jobs.has(head.job)) this.jobs.set(head.job, { ...head, said: [], lines: [], found: [], code: null });
    return this.jobs.get(head.job);
  }

  /** @param {any} message */
  answer(message) {
    const piece = this.pieces.get(message.answer?.upload);
    const waiting = this.waiting.get(message.to);
    if (waiting) {
      this.waiting.delete(message.to);
      if (message.refused) waiting.reject(new Error(message.refused));
      else waiting.resolve(message.answer);
    } else if (piece) piece(message);
    // A piece that is refused names no file; one comes at a time.
    else for (const take of this.pieces.values()) take(message);
  }

  /** @param {any} message @returns {Promise<any>} */
  ask(message) {
    const id = ++this.asked;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      const line = JSON.stringify({ id, ...message });
      if (!(this.isThere && this.link.send(line))) this.unsent.push(line);
    });
  }

  /** Start a command. @param {string} action @param {any} [values] @returns {Promise<number>} */
  async start(action, values = {}) {
    return (await this.ask({ run: action, values })).job;
  }

  /** Start a command and wait for its end. @param {string} action @param {any} [values] @returns {Promise<Job>} */
  async run(action, values = {}) {
    const number = await this.start(action, values);
    return new Promise((resolve, reject) => {
      const job = this.jobs.get(number);
      if (job && job.code !== null) resolve(job);
      else this.awaited.push({ number, resolve, reject });
    });
  }

  /** What a command prints; refuses with its sentence where it failed. @param {string} action @param {any} [values] @returns {Promise<any>} */
  async found(action, values = {}) {
    const job = await this.run(action, values);
    if (job.code !== 0) throw new Error(complaint(job));
    return job.found[0] ?? {};
  }

  /** The newest command of a kind. @param {string} action @param {(job: Job) => boolean} [fits] @returns {Job | undefined} */
  newest(action, fits = () => true) {
    return [...this.jobs.values()].filter((job) => job.action === action && fits(job)).pop();
  }

  /** A path of the folder of sessions as the program shows it, below that folder. @param {string} path */
  below(path) {
    const { root, separator } = this.head;
    return path.startsWith(root + separator) ? path.slice(root.length + 1) : path;
  }

  /** Its last part. @param {string} path @returns {string} */
  nameOf(path) {
    return path.slice(path.lastIndexOf(this.head.separator) + 1);
  }

  /** An address at which a file can be had once. @param {string} path @returns {Promise<string>} */
  async address(path) {
    return (await this.ask({ file: this.below(path) })).address;
  }

  /** @param {string} path */
  async save(path) {
    const link = document.createElement("a");
    link.href = await this.address(path);
    link.download = this.nameOf(path);
    link.click();
  }

  /**
   * Send a file up; returns where it is and the folder that others of the same recording go to.
   * @param {File} file @param {string | null} folder @param {(share: number) => void} onProgress
   * @returns {Promise<{file: string, folder: string}>}
   */
  async upload(file, folder, onProgress) {
    const begun = await this.ask({ upload: file.name, size: file.size, ...(folder ? { folder } : {}) });
    const head = new TextEncoder().encode(begun.upload);
    for (let start = 0; ; start += PIECE) {
      const data = await file.slice(start, start + PIECE).arrayBuffer();
      const piece = new Uint8Array(ID + data.byteLength);
      piece.set(head);
      piece.set(new Uint8Array(data), ID);
      const message = await new Promise((resolve) => {
        this.pieces.set(begun.upload, resolve);
        if (!this.link.send(piece)) resolve({ refused: text("away") });
      });
      this.pieces.delete(begun.upload);
      if (message.refused) throw new Error(message.refused);
      onProgress(1 - message.answer.left / file.size);
      if (!message.answer.left) return { file: message.answer.file, folder: begun.folder };
    }
  }
}

/** The last sentence of a command that failed. @param {Job} job */
export const complaint = (job) =>
  (job.said[job.said.length - 1] ?? text("ended", { code: String(job.code) })).replace(/^(imufield|Error): /, "");
