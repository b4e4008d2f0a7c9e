// Tones, the browser's voice and vibration. A browser lets none of them begin before somebody has touched the page.

/** Of events, in ms: for a hand that holds the phone. */
/** @type {Record<string, number[]>} */
const SHAKES = { hold: [40], accepted: [60, 60, 60], rejected: [300], suspect: [300], done: [80, 80, 80, 80, 200] };

/** @type {[number, number][]} */
const HELLO = [[660, 0.12]];

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
      this.play("", HELLO);
    }
    return this.audio !== null;
  }

  /** @param {string} kind of the event @param {[number, number][]} tones frequency in Hz and length in s */
  play(kind, tones) {
    // Refused, with a word in the console, until the page was touched.
    if (navigator.userActivation?.hasBeenActive && navigator.vibrate && SHAKES[kind]) navigator.vibrate(SHAKES[kind]);
    if (!this.audio) return;
    let at = this.audio.currentTime + 0.02;
    for (const [hertz, seconds] of tones) {
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
