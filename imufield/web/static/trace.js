// Six signals of the last half minute, a strip for each.

const NAMES = ["acc x", "acc y", "acc z", "gyro x", "gyro y", "gyro z"];
const SPAN_S = 30;
const LEAST = [0.5, 0.5, 0.5, 2, 2, 2]; // m/s², °/s: what is smaller is noise

/**
 * @param {HTMLCanvasElement} canvas
 * @param {(number | null)[][]} blocks time and six values, SI
 */
export function drawTrace(canvas, blocks) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(ratio, ratio);
  const style = getComputedStyle(document.documentElement);
  const present = NAMES.map((_, k) => k).filter((k) => blocks.some((block) => block[k + 1] !== null));
  if (!present.length) return;
  const newest = Number(blocks[blocks.length - 1][0]);
  const strip = height / present.length;
  const [left, right] = [86, 8];
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "middle";
  present.forEach((k, row) => {
    const factor = k < 3 ? 1 : 180 / Math.PI;
    const values = blocks.map((block) => (block[k + 1] === null ? NaN : Number(block[k + 1]) * factor));
    const known = values.filter(Number.isFinite);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const [middle, half] = [(low + high) / 2, Math.max(high - low, LEAST[k]) / 2];
    const y0 = strip * (row + 0.5);
    context.fillStyle = style.getPropertyValue("--text");
    context.textAlign = "left";
    context.fillText(NAMES[k], 0, y0 - 7);
    const last = values[values.length - 1];
    context.fillText(Number.isFinite(last) ? `${last.toFixed(2)} ${k < 3 ? "m/s²" : "°/s"}` : "–", 0, y0 + 8);
    context.strokeStyle = style.getPropertyValue("--line");
    context.beginPath();
    context.moveTo(left, strip * (row + 1) - 0.5);
    context.lineTo(width - right, strip * (row + 1) - 0.5);
    context.stroke();
    context.strokeStyle = style.getPropertyValue(`--signal-${"xyz"[k % 3]}`);
    context.lineWidth = 1.5;
    context.beginPath();
    let down = false;
    values.forEach((value, index) => {
      const age = newest - Number(blocks[index][0]);
      if (!Number.isFinite(value) || age > SPAN_S) {
        down = false;
        return;
      }
      const x = left + (1 - age / SPAN_S) * (width - left - right);
      const y = y0 - ((value - middle) / half) * strip * 0.4;
      if (down) context.lineTo(x, y);
      else context.moveTo(x, y);
      down = true;
    });
    context.stroke();
  });
}
