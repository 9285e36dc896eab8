// The page: time, mouse, touch and keys. An address may end in #camera=NAME&frame=12&plain (no controls).

const element = (name) => document.getElementById(name);
const MOST_DENSE = 2; // canvas pixels for one of the page's
const SLOW = 40, FAST = 25; // milliseconds a frame: above one it is drawn with fewer pixels, below the other with more
const LEAST_SHARP = 0.3; // of both sides
const STILL_AFTER = 250; // milliseconds

/** Says a sentence over the image, or takes it away. */
function tell(words, again = false) {
  element("words").textContent = words;
  element("told").hidden = !words;
  element("again").hidden = !again;
}

/** Bytes of text whose characters are 15 bits each, from U+0100 on. */
function bytesOf(text) {
  const bytes = new Uint8Array((text.length * 15) / 8);
  for (let i = 0, at = 0, held = 0, bits = 0; i < text.length; i++) {
    held = ((held & 127) << 15) | (text.charCodeAt(i) - 256);
    for (bits += 15; bits >= 8; ) bytes[at++] = held >> (bits -= 8);
  }
  return bytes;
}

class Page {
  /** Throws an Error with a sentence where the browser cannot play. */
  constructor(scene) {
    if (typeof DecompressionStream === "undefined") throw new Error("This browser is too old for this page.");
    this.scene = scene;
    this.renderer = new SplatRenderer(element("canvas"), scene);
    this.worker = new Worker(URL.createObjectURL(new Blob([element("worker").textContent])));
    this.worker.onmessage = ({ data }) => this.hear(data);
    this.worker.postMessage({ description: scene });
    this.come = this.arrived = 0; // bytes and frames
    this.spare = {}; // arrays that the worker fills again
    this.view = new View(scene);
    this.canvas = element("canvas");
    this.frame = 0;
    this.playing = false;
    this.pointers = new Map();
    this.moved_at = -Infinity;
    this.pace = FAST;
    this.sharpness = 1;
    this.listen();
    addEventListener("DOMContentLoaded", () => this.read());
    this.follow(new URLSearchParams(location.hash.slice(1)));
    new ResizeObserver(() => this.fit()).observe(this.canvas);
    this.fit();
    element("bar").hidden = false;
    Headset.offer(element("bar"), (mode) => this.enter(mode));
  }

  /** Draws for a headset until its session ends. */
  async enter(mode) {
    try {
      const headset = await Headset.begin(mode, this.renderer.gl, this.view);
      const change = (now) => {
        this.headset = now;
        this.waiting = false; // the other clock may stand
        this.redraw();
      };
      headset.session.addEventListener("end", () => change(undefined));
      headset.session.addEventListener("select", () => this.play(!this.playing));
      change(headset);
    } catch (error) {
      tell(`The headset cannot be used (${error.message}).`);
    }
  }

  /** What the address asks for. */
  follow(asked) {
    document.body.classList.toggle("plain", asked.has("plain"));
    const camera = this.view.cameras.findIndex(({ name }) => name === asked.get("camera"));
    this.look(Math.max(camera, 0));
    this.seek(Number(asked.get("frame")) || 0);
    if (!asked.has("frame") && !asked.has("plain") && this.scene.frames > 1) this.play(true);
  }

  listen() {
    const { canvas } = this;
    const time = element("time");
    time.max = Math.max(this.scene.frames - 1, 1);
    time.disabled = element("play").disabled = this.scene.frames < 2;
    time.addEventListener("input", () => { this.play(false); this.seek(Number(time.value)); });
    element("play").addEventListener("click", () => this.play(!this.playing));
    element("reset").addEventListener("click", () => this.look(this.camera));
    element("full").addEventListener("click", () => this.fullScreen());
    element("full").hidden = !document.fullscreenEnabled;
    const cameras = element("cameras");
    this.view.cameras.forEach((camera, index) => cameras.add(new Option(camera.name, index)));
    cameras.hidden = !this.view.cameras.length;
    cameras.addEventListener("change", () => this.look(Number(cameras.value)));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus();
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // it is restored only then
      tell("The browser lost its graphics. The picture comes back by itself where it can.", true);
      element("poster").hidden = false;
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.renderer.prepare();
      tell("");
      this.everything = true;
      this.redraw();
    });
    element("again").addEventListener("click", () => {
      const camera = this.view.cameras[this.camera]?.name ?? "";
      location.hash = new URLSearchParams({ camera, frame: this.frame });
      location.reload();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.view.dolly(Math.exp(Math.max(-1, Math.min(event.deltaY * 0.0015, 1))));
      this.move();
    }, { passive: false });
    addEventListener("keydown", (event) => this.pressed(event));
    addEventListener("hashchange", () => this.follow(new URLSearchParams(location.hash.slice(1))));
  }

  /** What stands behind the data, or where that is. */
  async read() {
    const sound = element("sound").textContent;
    if (sound) this.sound = new Audio(sound);
    try {
      if (this.scene.source) {
        const response = await fetch(this.scene.source);
        if (!response.ok) throw new Error(response.statusText);
        await response.body.pipeTo(new WritableStream({ write: (bytes) => this.give(bytes) }));
      }
      this.worker.postMessage({ end: true });
    } catch (error) {
      fail(`The scene's data cannot be fetched from here (${error.message}).`);
    }
  }

  /** Hands bytes on as they come. */
  give(bytes) {
    this.come += bytes.length;
    element("loading").value = this.come / this.scene.bytes;
    this.worker.postMessage({ bytes }, [bytes.buffer]);
  }

  /** What the worker says. */
  hear(said) {
    if (said.failed) return fail(said.failed);
    if (said.whole) {
      this.whole = element("loading").hidden = true;
      if (this.playing) this.play(true); // with its sound
    } else if (said.arrived) {
      this.arrived = said.arrived;
      this.sorted = ""; // there is more to show
    } else {
      this.renderer.upload(said);
      this.spare = said;
      this.asked = false;
      this.shown = said.frame;
    }
    this.redraw();
  }

  /** Has the worker bring the Gaussians to a frame and sort them for a view; false if it has just done so. */
  ask(view) {
    if (this.asked) return true;
    const direction = view.axes[2];
    const shift = dot(direction, view.center);
    const { frame, everything } = this;
    const wish = [frame, direction, shift].join();
    if (!this.arrived || (wish === this.sorted && !everything)) return false;
    this.sorted = wish;
    this.asked = true;
    this.everything = false;
    const { order, numbers } = this.spare;
    const given = order ? [order.buffer, numbers.buffer] : [];
    this.worker.postMessage({ frame, direction, shift, everything, spare: { order, numbers } }, given);
    return true;
  }

  /** One finger or the left button turns; two fingers, Shift, or another button move sideways; a pinch goes nearer. */
  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const across = (now[0] - before[0]) / this.canvas.clientHeight;
    const down = (now[1] - before[1]) / this.canvas.clientHeight;
    if (this.pointers.size > 1) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
      const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
      this.view.dolly(apart(before) / apart(now));
      this.view.pan(-across / 2, -down / 2);
    } else if (event.shiftKey || event.buttons > 1) this.view.pan(-across, -down);
    else this.view.orbit(across * 4, -down * 4);
    this.pointers.set(event.pointerId, now);
    this.move();
  }

  /** Keys by their letter whatever Shift and Caps Lock say, and by their place where the letters are others. */
  pressed(event) {
    const actions = {
      " ": () => this.play(!this.playing),
      arrowleft: () => { this.play(false); this.seek(Math.ceil(this.frame) - 1); },
      arrowright: () => { this.play(false); this.seek(Math.floor(this.frame) + 1); },
      home: () => this.look(this.camera),
      c: () => this.look((this.camera + 1) % Math.max(this.view.cameras.length, 1)),
      f: () => this.fullScreen(),
    };
    const action = actions[event.key.toLowerCase()] ?? actions[event.code.replace("Key", "").toLowerCase()];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("select") || (event.key === " " && event.target.matches("button"))) return; // their own
    event.preventDefault();
    action();
  }

  look(index) {
    this.camera = index;
    element("cameras").value = index;
    this.view.look(index);
    this.redraw();
  }

  fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen?.();
  }

  play(on) {
    this.playing = on && this.scene.frames > 1;
    element("play").textContent = this.playing ? "Pause" : "Play";
    this.played = undefined;
    if (this.sound && this.whole) {
      if (this.playing) this.follow_sound();
      else this.sound.pause();
    }
    if (this.playing) this.redraw();
  }

  /** Starts the sound at the frame that is shown; a browser may ask for a click first. */
  follow_sound() {
    this.sound.currentTime = this.frame / this.scene.frames_per_second;
    this.sound.play().catch(() => {});
  }

  /** Goes to a frame, which may lie between two. */
  seek(frame) {
    this.frame = Math.min(Math.max(frame, 0), this.scene.frames - 1);
    element("time").value = this.frame;
    this.move();
  }

  fit() {
    const scale = Math.min(devicePixelRatio || 1, MOST_DENSE);
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    this.redraw();
  }

  /** Draws an image of several that follow one another. */
  move() {
    this.moved_at = performance.now();
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    (this.headset?.session ?? window).requestAnimationFrame((now, frame) => {
      this.waiting = false;
      if (this.playing) this.advance(now);
      const moves = this.playing || frame !== undefined || now - this.moved_at < STILL_AFTER;
      this.keep_pace(now, moves);
      const views = (frame && this.headset?.eyes(frame)) ?? [this.view];
      const asked = this.ask(views[0] ?? this.view);
      const sharpness = moves ? this.sharpness : 1;
      if (this.shown !== undefined && views.every((view) => this.renderer.draw(view, sharpness))) {
        element("poster").hidden = true;
        document.documentElement.dataset.shown = `${this.view.cameras[this.camera]?.name ?? ""} ${this.shown}`;
      }
      document.documentElement.classList.toggle("still", this.whole === true && !moves && !asked);
      if (moves) this.redraw();
    });
  }

  /** Fewer pixels while frames come slowly. */
  keep_pace(now, moves) {
    if (moves && this.moved_before) {
      this.pace += 0.3 * (Math.min(now - this.drawn_at, 5 * SLOW) - this.pace);
      if (this.pace < FAST) this.sharpness = Math.min(this.sharpness * 1.03, 1);
      if (this.pace > SLOW) {
        this.sharpness = Math.max(this.sharpness * Math.sqrt(SLOW / this.pace), LEAST_SHARP);
        this.pace = FAST; // until it is known how fast fewer are
      }
    }
    this.moved_before = moves;
    this.drawn_at = now;
  }

  advance(now) {
    const last = this.scene.frames - 1;
    const passed = this.played === undefined ? 0 : ((now - this.played) / 1000) * this.scene.frames_per_second;
    this.played = now;
    const next = this.frame + passed;
    if (this.arrived < this.scene.frames) this.frame = Math.min(next, Math.max(this.arrived - 1, this.frame));
    else this.frame = next > last ? 0 : next;
    if (next > last && this.sound) this.follow_sound();
    element("time").value = this.frame;
  }
}

/** Says what went wrong; what is shown already stays, and nothing else. */
function fail(words) {
  tell(words);
  element("loading").hidden = true;
  element("canvas").hidden = element("bar").hidden = !element("poster").hidden;
  document.documentElement.dataset.failed = words;
}

addEventListener("error", (event) => {
  event.preventDefault();
  if (event.error) fail(event.error.message);
});
let page;
page = new Page(JSON.parse(element("description").textContent));

/** Called behind each part of the data, which may still be on its way. */
function arrived() {
  const part = document.currentScript.previousElementSibling;
  if (page) page.give(bytesOf(part.textContent).subarray(0, page.scene.bytes - page.come));
  part.remove();
}
