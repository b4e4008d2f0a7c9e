// Keeps the screen on. Browsers allow the wake lock over https and on this machine only; elsewhere a video that plays keeps it on,
// and where that is refused too, the page says what to do.

/** @type {HTMLVideoElement | null} */
let film = null;

/** Whether a browser allows something. @param {() => Promise<unknown>} ask */
async function isAllowed(ask) {
  try {
    await ask();
    return true;
  } catch (error) {
    // Refused: low battery, a rule of the system, or nobody has touched the page yet. Anything else is a defect.
    if (!(error instanceof DOMException)) throw error;
    return false;
  }
}

async function lock() {
  if ("wakeLock" in navigator) return isAllowed(() => navigator.wakeLock.request("screen"));
  const video = (film ??= makeFilm());
  return video !== null && isAllowed(() => video.play());
}

/** @returns {HTMLVideoElement | null} of two by two points, once a second a new picture */
function makeFilm() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 2;
  const context = canvas.getContext("2d");
  if (!context || !("captureStream" in canvas)) return null;
  setInterval(() => context.fillRect(0, 0, 2, 2), 1000);
  const video = document.createElement("video");
  video.srcObject = canvas.captureStream(1);
  video.muted = true;
  video.setAttribute("playsinline", "");
  return video;
}

/** @param {(isAwake: boolean) => void} say */
export function keepAwake(say) {
  const begin = () => document.hidden || lock().then(say);
  begin();
  document.addEventListener("visibilitychange", begin);
}
