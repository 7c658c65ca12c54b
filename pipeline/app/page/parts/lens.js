// A magnified part of the frame, beside the place that is pointed at.
import { html, useEffect, useRef } from "../html.js";

const SIZE = 168;
const TIMES = 4;

/** Show the surroundings of a place, px, of the image with an id; nothing without a place. */
export function Lens({ at, image: id }) {
  const canvas = useRef(null);
  useEffect(() => {
    const image = document.getElementById(id);
    if (!at || !image?.naturalWidth) return;
    drawLens(canvas.current.getContext("2d"), image, at);
    const shown = image.clientWidth / image.naturalWidth;
    const [x, y] = [at[0] * shown, at[1] * shown];
    canvas.current.style.left = `${x + (x < image.clientWidth / 2 ? 30 : -SIZE - 30)}px`;
    canvas.current.style.top = `${Math.max(0, Math.min(image.clientHeight - SIZE, y - SIZE / 2))}px`;
  }, [at]);
  return html`<canvas id="lens" class="lens" ref=${canvas} width=${SIZE} height=${SIZE} hidden=${!at}></canvas>`;
}

function drawLens(context, image, [x, y]) {
  const size = SIZE / TIMES * image.naturalWidth / Math.max(image.clientWidth, 1);
  context.fillStyle = "#101512";
  context.fillRect(0, 0, SIZE, SIZE);
  context.drawImage(image, x + 0.5 - size / 2, y + 0.5 - size / 2, size, size, 0, 0, SIZE, SIZE);
  context.strokeStyle = "#ffd666";
  context.lineWidth = 1.5;
  context.beginPath();
  for (const [a, b] of [[[0, 0.5], [0.44, 0.5]], [[0.56, 0.5], [1, 0.5]], [[0.5, 0], [0.5, 0.44]], [[0.5, 0.56], [0.5, 1]]]) {
    context.moveTo(a[0] * SIZE, a[1] * SIZE);
    context.lineTo(b[0] * SIZE, b[1] * SIZE);
  }
  context.stroke();
}
