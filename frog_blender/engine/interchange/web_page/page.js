// The page: time, mouse, touch and keys. An address may end in #camera=NAME&frame=12&plain (no controls).

const element = (name) => document.getElementById(name);

class Page {
  constructor(scene, renderer) {
    this.scene = scene;
    this.renderer = renderer;
    this.view = new View(scene);
    this.canvas = element("canvas");
    this.frame = 0;
    this.playing = false;
    this.pointers = new Map();
    this.listen();
    this.follow(new URLSearchParams(location.hash.slice(1)));
    new ResizeObserver(() => this.fit()).observe(this.canvas);
    this.fit();
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
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.view.dolly(Math.exp(Math.max(-1, Math.min(event.deltaY * 0.0015, 1))));
      this.redraw();
    }, { passive: false });
    addEventListener("keydown", (event) => this.pressed(event));
    addEventListener("hashchange", () => this.follow(new URLSearchParams(location.hash.slice(1))));
    const sound = element("sound").textContent;
    if (sound) this.sound = new Audio(sound);
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
    this.redraw();
  }

  pressed(event) {
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => { this.play(false); this.seek(Math.ceil(this.frame) - 1); },
      ArrowRight: () => { this.play(false); this.seek(Math.floor(this.frame) + 1); },
      Home: () => this.look(this.camera),
      c: () => this.look((this.camera + 1) % Math.max(this.view.cameras.length, 1)),
      f: () => this.fullScreen(),
    };
    const action = actions[event.key];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
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
    if (this.sound) {
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
    this.redraw();
  }

  fit() {
    const scale = devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      if (this.playing) this.advance(now);
      if (this.scene.show(this.frame)) this.renderer.update();
      this.renderer.draw(this.view);
      document.documentElement.dataset.shown = `${this.view.cameras[this.camera]?.name ?? ""} ${this.frame}`;
      if (this.playing) this.redraw();
    });
  }

  advance(now) {
    const last = this.scene.frames - 1;
    const passed = this.played === undefined ? 0 : ((now - this.played) / 1000) * this.scene.frames_per_second;
    this.played = now;
    const next = this.frame + passed;
    this.frame = next > last ? 0 : next;
    if (next > last && this.sound) this.follow_sound();
    element("time").value = this.frame;
  }
}

async function open() {
  const told = element("told");
  try {
    if (typeof DecompressionStream === "undefined") throw new Error("This browser is too old for this page.");
    const description = JSON.parse(element("description").textContent);
    const scene = await Scene.load(description, bytesOf(element("data").textContent));
    scene.show(0);
    new Page(scene, new SplatRenderer(element("canvas"), scene));
    told.remove();
  } catch (error) {
    told.textContent = error.message;
    document.documentElement.dataset.failed = error.message;
  }
}

open();
