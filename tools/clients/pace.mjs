// How fast a viewer of the web is, and how much it holds: node pace.mjs JOB.json, in a folder like that of view.mjs. A
// job has what viewers.js wants, or the url of our own page, and further matrices of a camera that moves. One line of
// JSON is printed: milliseconds from navigation to the first picture, those of each moved frame, those of the processor
// that each took in all threads, and memory in bytes.
import { readFileSync } from "node:fs";
import { browser, origin, server } from "./serve.mjs";

const PATIENCE = 120_000, STAYS = 3000;
const job = JSON.parse(readFileSync(process.argv[2], "utf8"));

/** In the page, before anything of it: each animation frame is waited for until its pixels can be read. */
function watch(job) {
  window.job = job.viewer && job;
  const STEP = 8; // pixels between those that are compared
  const seen = window.seen = { pictures: [], changed: 0, moved: [] };
  let gl, moves, done, drawn = false;
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    const draws = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...numbers) {
      drawn = true;
      gl = this;
      return draws.apply(this, numbers);
    };
  }

  /** What the canvas shows; returns once all is drawn. */
  function pixels(width, height) {
    const framebuffer = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
    const pack = gl.getParameter(gl.PIXEL_PACK_BUFFER_BINDING);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    const found = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, found);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, pack);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    return found;
  }

  /** Keeps a few pixels of each picture. */
  function keep() {
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    const all = pixels(width, height), few = [];
    for (let y = 0; y < height; y += STEP)
      for (let x = 0; x < width; x += STEP) few.push(...all.subarray(4 * (y * width + x), 4 * (y * width + x) + 3));
    const time = performance.now(), before = seen.pictures.at(-1)?.few;
    if (!before || few.some((value, index) => Math.abs(value - before[index]) > 2)) seen.changed = time;
    seen.pictures.push({ time, few: Uint8Array.from(few) });
  }

  const soon = requestAnimationFrame.bind(window);
  window.requestAnimationFrame = draw => soon(now => {
    drawn = false;
    const start = performance.now();
    if (moves?.length) window.look(moves[0]);
    draw(now);
    if (!drawn) return;
    if (!moves) return keep();
    if (!moves.length) return;
    pixels(1, 1);
    seen.moved.push(performance.now() - start);
    moves.shift();
    if (!moves.length) done();
  });

  /** Moves the camera with each frame. */
  window.move = matrices => new Promise(resolve => {
    [moves, done, seen.moved] = [[...matrices], () => resolve(seen.moved), []];
    window.look(matrices[0]); // a page that stood still draws again
  });

  /** Milliseconds until the first picture that is like the one that stays (30 dB); undefined while it changes. */
  window.first = stays => {
    const last = seen.pictures.at(-1);
    if (!last?.few.some(value => value > 50) || performance.now() - seen.changed < stays) return undefined;
    const error = few => few.reduce((sum, value, index) => sum + (value - last.few[index]) ** 2, 0) / few.length;
    return seen.pictures.find(({ few }) => error(few) < 255 ** 2 / 1000).time;
  };
}

/** In our own page: the camera's matrix as its view has it, with all pixels if wanted. */
function ours(sharp) {
  window.look = matrix => {
    const [x, y, z, center] = [0, 4, 8, 12].map(at => matrix.slice(at, at + 3));
    page.view.axes = [x, y.map(value => -value), z.map(value => -value)];
    page.view.center = center;
    page.move();
  };
  page.sharpness = 1;
  if (sharp) page.keep_pace = () => {};
}

/** Milliseconds, of all threads; Linux counts hundredths of a second. */
const processor = pid => {
  const numbers = readFileSync(`/proc/${pid}/stat`, "utf8").split(") ")[1].split(" ");
  return 10 * (Number(numbers[11]) + Number(numbers[12]));
};
const memory = pid => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) * 1024;

try {
  const page = await browser.newPage({ viewport: { width: job.width, height: job.height } });
  const said = [];
  page.on("pageerror", error => said.push(error.message));
  page.setDefaultTimeout(PATIENCE);
  await page.addInitScript(watch, job);
  await page.goto(origin + (job.viewer ? "/view.html" : job.url), { waitUntil: "commit" });
  const started = Date.now();
  let first;
  while ((first = await page.evaluate(stays => window.first(stays), STAYS) ?? undefined) === undefined) {
    if (said.length || Date.now() - started > PATIENCE) throw new Error(said[0] ?? "no picture that stays in two minutes");
    await page.waitForTimeout(500);
  }
  if (!job.viewer) await page.evaluate(ours, job.sharp);
  const browserSession = await browser.newBrowserCDPSession();
  const { processInfo } = await browserSession.send("SystemInfo.getProcessInfo");
  const largest = kind => processInfo.filter(({ type }) => type === kind).map(({ id }) => id)
    .reduce((best, id) => (memory(id) > memory(best) ? id : best));
  const [renderer, gpu] = [largest("renderer"), largest("GPU")];
  const late = new Promise((_, fail) => setTimeout(() => fail(new Error("no moved frames in two minutes")), PATIENCE).unref());
  const moved = matrices => Promise.race([page.evaluate(matrices => window.move(matrices), matrices), late]);
  await moved(job.matrices.slice(0, job.before));
  const before = processor(renderer) + processor(gpu);
  const frames = await moved(job.matrices.slice(job.before));
  const work = (processor(renderer) + processor(gpu) - before) / frames.length;
  const sharpness = job.viewer ? 1 : await page.evaluate("page.sharpness");
  await page.waitForTimeout(STAYS);
  await page.screenshot({ path: job.picture });
  const session = await page.context().newCDPSession(page);
  await session.send("HeapProfiler.collectGarbage");
  await session.send("Performance.enable");
  const { metrics } = await session.send("Performance.getMetrics");
  const heap = metrics.find(({ name }) => name === "JSHeapUsedSize").value;
  const held = { heap, renderer: memory(renderer), gpu: memory(gpu) };
  console.log(JSON.stringify({ first, frames, work, sharpness, ...held }));
} catch (error) {
  console.log(JSON.stringify({ error: error.message.replace("page.evaluate: ", "").split("\n")[0] }));
}
await browser.close();
server.close();
