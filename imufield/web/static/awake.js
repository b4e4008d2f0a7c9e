// Keeps the screen on. Browsers allow the wake lock over https and on this machine only; elsewhere a video that plays keeps it on,
// and where that is refused too, the page says what to do.

/** @param {(words: string) => void} say */
export function keepAwake(say) {
  const lock = async () => {
    if (!("wakeLock" in navigator) || document.hidden) return false;
    try {
      await navigator.wakeLock.request("screen");
      return true;
    } catch {
      return false; // Low battery, or a rule of the system.
    }
  };
  const film = async () => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 2;
    const context = canvas.getContext("2d");
    const video = document.createElement("video");
    if (!context || !("captureStream" in canvas)) return false;
    setInterval(() => context.fillRect(0, 0, 2, 2), 1000);
    video.srcObject = canvas.captureStream(1);
    video.muted = true;
    video.setAttribute("playsinline", "");
    try {
      await video.play();
      return true;
    } catch {
      return false;
    }
  };
  const begin = async () => {
    const awake = (await lock()) || (!("wakeLock" in navigator) && (await film()));
    say(awake ? "" : "set the screen of this device to stay on");
  };
  begin();
  document.addEventListener("visibilitychange", () => document.hidden || begin());
}
