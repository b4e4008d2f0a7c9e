// Tones, the browser's voice and vibration. A browser lets none of them begin before somebody has touched the page.

/** Tones as in the terminal: frequency in Hz and length in s. */
/** @type {Record<string, [number, number][]>} */
const TONES = {
  hold: [[660, 0.12]],
  accepted: [[880, 0.12], [1320, 0.22]],
  rejected: [[220, 0.4]],
  turn: [[660, 0.1]],
  link_lost: [[220, 0.25], [165, 0.4]],
  link_back: [[440, 0.12], [660, 0.12]],
  done: [[880, 0.15], [1109, 0.15], [1320, 0.4]],
};
/** @type {Record<string, number[]>} */
const SHAKES = { hold: [40], accepted: [60, 60, 60], rejected: [300], done: [80, 80, 80, 80, 200] };

export class Sound {
  constructor() {
    /** @type {AudioContext | null} */
    this.audio = null;
    this.voice = false;
  }

  /** @returns {boolean} whether it sounds now; called by a tap */
  toggle() {
    if (this.audio) {
      this.audio.close();
      this.audio = null;
    } else {
      this.audio = new AudioContext();
      this.play("hold");
    }
    return this.audio !== null;
  }

  /** @param {string} kind */
  play(kind) {
    // Refused, with a word in the console, until the page was touched.
    if (navigator.userActivation?.hasBeenActive && navigator.vibrate && SHAKES[kind]) navigator.vibrate(SHAKES[kind]);
    if (!this.audio || !TONES[kind]) return;
    let at = this.audio.currentTime + 0.02;
    for (const [hertz, seconds] of TONES[kind]) {
      const [tone, gain] = [this.audio.createOscillator(), this.audio.createGain()];
      tone.frequency.value = hertz;
      tone.connect(gain).connect(this.audio.destination);
      gain.gain.setValueAtTime(0.0001, at);
      gain.gain.exponentialRampToValueAtTime(0.4, at + 0.02);
      gain.gain.exponentialRampToValueAtTime(0.0001, at + seconds);
      tone.start(at);
      tone.stop(at + seconds);
      at += seconds;
    }
  }

  /** @param {string} words */
  say(words) {
    if (!this.voice || !("speechSynthesis" in window)) return;
    speechSynthesis.cancel();
    const spoken = new SpeechSynthesisUtterance(words);
    spoken.lang = "en";
    speechSynthesis.speak(spoken);
  }
}
