// Beside the page: unpacks what arrives, brings the Gaussians to a frame and sorts them.

/** The Gaussians before a camera, the farthest first: two passes of a radix sort over the bits of their depths. */
class DepthSorter {
  constructor(count) {
    this.depths = new Float32Array(count);
    this.bits = new Uint32Array(this.depths.buffer); // ascend as positive depths do
    this.indices = new Uint32Array(count);
    this.between = new Uint32Array(count);
    this.starts = new Uint32Array(65536);
  }

  /** Writes indices; returns how many. */
  sort(scene, [x, y, z], shift, indices) {
    const stride = 4 * scene.texels;
    let kept = 0;
    for (let i = 0; i < scene.count; i++) {
      const at = i * stride;
      const depth = x * scene.numbers[at] + y * scene.numbers[at + 1] + z * scene.numbers[at + 2] - shift;
      if (depth < 0.01) continue;
      this.depths[i] = depth;
      this.indices[kept++] = i;
    }
    this.pass(this.indices, this.between, kept, 0);
    this.pass(this.between, indices, kept, 16);
    return kept;
  }

  pass(source, target, count, shift) {
    const { starts, bits } = this;
    starts.fill(0);
    for (let i = 0; i < count; i++) starts[(bits[source[i]] >>> shift) & 65535]++;
    let sum = 0;
    for (let key = 65535; key >= 0; key--) {
      const entries = starts[key];
      starts[key] = sum;
      sum += entries;
    }
    for (let i = 0; i < count; i++) target[starts[(bits[source[i]] >>> shift) & 65535]++] = source[i];
  }
}

let scene, sorter, writer;

function take(bytes) {
  const before = scene.next;
  scene.add(bytes);
  if (scene.next > before && scene.arrived) postMessage({ arrived: scene.arrived });
}

function end() {
  if (scene.next < scene.coming.length) throw new Error("It ends too soon.");
  postMessage({ whole: true });
}

/** Arrays that were handed back are used again. */
function answer({ frame, direction, shift, everything, spare }) {
  const rows = Math.max(scene.show(frame), everything ? scene.texture[1] : 0);
  const [row] = scene.texture;
  const order = spare.order ?? new Uint32Array(row * Math.ceil(scene.count / row)); // whole rows of a texture
  const length = 4 * row * rows;
  const numbers = spare.numbers?.length === length ? spare.numbers : new Float32Array(length);
  numbers.set(scene.numbers.subarray(0, length));
  const kept = sorter.sort(scene, direction, shift, order);
  postMessage({ frame: scene.frame, order, kept, numbers, rows }, [order.buffer, numbers.buffer]);
}

onmessage = ({ data }) => {
  if (data.description) {
    scene = new Scene(data.description);
    sorter = new DepthSorter(scene.count);
    const inflater = new DecompressionStream("deflate");
    writer = inflater.writable.getWriter();
    const failed = "The scene's data is damaged.";
    inflater.readable.pipeTo(new WritableStream({ write: take, close: end })).catch(() => postMessage({ failed }));
  } else if (data.bytes) writer.write(data.bytes).catch(() => {}); // the reader fails as well
  else if (data.end) writer.close().catch(() => {});
  else answer(data);
};
