// Draws Gaussians with WebGL 2 as the FROG engine does: sorted by depth, blended back to front.

const ROW = 2048; // texels of a texture's row

const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D numbers;
uniform mat3 axes;         // world to camera
uniform vec3 center;       // of the camera
uniform vec4 intrinsics;   // fx, fy, cx, cy in pixels
uniform vec2 size;         // of the canvas in pixels
uniform int texels, coefficients;
uniform vec3 exposure;
in uint index;
flat out vec3 conic;
flat out vec4 color;
out vec2 offset;           // pixels from the splat's middle

vec4 texel(int which) {
  int place = int(index) * texels + which;
  return texelFetch(numbers, ivec2(place % ${ROW}, place / ${ROW}), 0);
}

vec3 sh(int which) { return texel(3 + which).rgb; }

vec3 colorFrom(vec3 d) {
  vec3 sum = 0.28209479 * sh(0);
  if (coefficients > 1) sum += 0.48860251 * (-d.y * sh(1) + d.z * sh(2) - d.x * sh(3));
  vec3 s = d * d;
  if (coefficients > 4)
    sum += 1.09254843 * (d.x * d.y * sh(4) - d.y * d.z * sh(5) - d.x * d.z * sh(7)) +
           0.31539157 * (2.0 * s.z - s.x - s.y) * sh(6) + 0.54627422 * (s.x - s.y) * sh(8);
  if (coefficients > 9)
    sum += -0.59004359 * d.y * (3.0 * s.x - s.y) * sh(9) + 2.89061144 * d.x * d.y * d.z * sh(10) -
           0.45704580 * d.y * (4.0 * s.z - s.x - s.y) * sh(11) +
           0.37317633 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y) * sh(12) -
           0.45704580 * d.x * (4.0 * s.z - s.x - s.y) * sh(13) + 1.44530572 * d.z * (s.x - s.y) * sh(14) -
           0.59004359 * d.x * (s.x - 3.0 * s.y) * sh(15);
  return max(sum + 0.5, 0.0) * exposure;
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside
  vec4 place = texel(0);
  vec3 away = place.xyz - center, local = axes * away;
  float opacity = min(place.w, 1.0);
  if (local.z < 0.01 || opacity <= 1.0 / 255.0) return;
  vec2 focal = intrinsics.xy, principal = intrinsics.zw, margin = 0.15 * size;
  vec2 tangent = clamp(local.xy / local.z, (-margin - principal) / focal, (size + margin - principal) / focal);
  vec4 q = normalize(texel(1));
  mat3 rotation = mat3(
    1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
    2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
    2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
  mat3 turned = axes * rotation;
  vec3 scale = texel(2).xyz;
  // Rows of the projection's Jacobian times the Gaussian's half axes.
  vec3 a = focal.x / local.z * (vec3(turned[0].x, turned[1].x, turned[2].x) -
                                tangent.x * vec3(turned[0].z, turned[1].z, turned[2].z)) * scale;
  vec3 b = focal.y / local.z * (vec3(turned[0].y, turned[1].y, turned[2].y) -
                                tangent.y * vec3(turned[0].z, turned[1].z, turned[2].z)) * scale;
  const float low = 0.3; // variance that 3DGS adds, in pixels squared
  float xx = dot(a, a) + low, xy = dot(a, b), yy = dot(b, b) + low;
  vec3 across = cross(a, b);
  float determinant = dot(across, across) + low * (dot(a, a) + dot(b, b)) + low * low;
  conic = vec3(yy, -xy, xx) / determinant;
  vec2 reach = sqrt(2.0 * log(opacity * 255.0) * vec2(xx, yy)); // where alpha falls below 1 / 255
  vec2 middle = focal * local.xy / local.z + principal;
  if (any(lessThan(middle + reach, vec2(0.0))) || any(greaterThan(middle - reach, size))) return;
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  offset = corner * (reach + 0.5);
  color = vec4(colorFrom(normalize(away)), opacity);
  vec2 clip = (middle + offset) / size * 2.0 - 1.0;
  gl_Position = vec4(clip.x, -clip.y, 0.0, 1.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
flat in vec3 conic;
flat in vec4 color;
in vec2 offset;
out vec4 result;
void main() {
  float power = -0.5 * (conic.x * offset.x * offset.x + conic.z * offset.y * offset.y) - conic.y * offset.x * offset.y;
  float alpha = color.a * exp(power);
  if (alpha < 1.0 / 255.0) discard;
  alpha = min(alpha, 0.999);
  result = vec4(color.rgb * alpha, alpha);
}`;

const COPY_VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

const COPY_FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D image;
out vec4 result;
void main() { result = vec4(texelFetch(image, ivec2(gl_FragCoord.xy), 0).rgb, 1.0); }`;

class SplatRenderer {
  /** Throws an Error with a sentence where the browser cannot draw. */
  constructor(canvas, scene) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser offers no WebGL 2, which this page draws with.");
    // Sums of many splats need more than eight bits, and may exceed 1 before they are covered.
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float"))
      throw new Error("This browser's WebGL draws into no half floats, which this page needs.");
    this.gl = gl;
    this.canvas = canvas;
    this.scene = scene;
    this.splats = this.program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.copy = this.program(COPY_VERTEX, COPY_FRAGMENT);
    this.rows = Math.ceil((scene.count * scene.texels) / ROW);
    if (this.rows > gl.getParameter(gl.MAX_TEXTURE_SIZE))
      throw new Error(`This device has room for fewer than the scene's ${scene.count.toLocaleString()} Gaussians.`);
    this.padded = new Float32Array(this.rows * ROW * 4);
    this.numbers = this.texture();
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, ROW, this.rows);
    this.upload(this.rows);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.order = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    const place = gl.getAttribLocation(this.splats, "index");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribIPointer(place, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(place, 1);
    this.sorter = new DepthSorter(scene.count);
    this.target = null;
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS))
      throw new Error(`This device's WebGL cannot draw the scene (${gl.getProgramInfoLog(program)}).`);
    return program;
  }

  texture() {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    return texture;
  }

  /** Hands the first rows of the scene's numbers to the card. */
  upload(rows) {
    const gl = this.gl;
    const end = Math.min(rows * ROW * 4, this.scene.numbers.length);
    this.padded.set(this.scene.numbers.subarray(0, end));
    gl.bindTexture(gl.TEXTURE_2D, this.numbers);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW, rows, gl.RGBA, gl.FLOAT, this.padded);
  }

  /** After the scene went to another frame. */
  update() {
    this.upload(Math.min(this.rows, Math.ceil((this.scene.dynamic * this.scene.texels) / ROW)));
  }

  draw(view) {
    const { gl, canvas, scene } = this;
    const { width, height } = canvas;
    this.resize(width, height);
    const order = this.sorter.sort(scene, view);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.viewport(0, 0, width, height);
    const [red, green, blue] = scene.background.map((value, channel) => value * view.exposure[channel]);
    gl.clearColor(red, green, blue, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(this.splats);
    const at = (name) => gl.getUniformLocation(this.splats, name);
    gl.uniformMatrix3fv(at("axes"), true, view.axes.flat());
    gl.uniform3fv(at("center"), view.center);
    gl.uniform4fv(at("intrinsics"), view.intrinsics(width, height));
    gl.uniform2f(at("size"), width, height);
    gl.uniform1i(at("texels"), scene.texels);
    gl.uniform1i(at("coefficients"), scene.sh_count);
    gl.uniform3fv(at("exposure"), view.exposure);
    gl.bindTexture(gl.TEXTURE_2D, this.numbers);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, order.length);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.copy);
    gl.bindTexture(gl.TEXTURE_2D, this.target);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  resize(width, height) {
    if (this.target && this.width === width && this.height === height) return;
    const gl = this.gl;
    if (this.target) gl.deleteTexture(this.target);
    else this.buffer = gl.createFramebuffer();
    this.target = this.texture();
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.target, 0);
    [this.width, this.height] = [width, height];
  }
}

/** The Gaussians before a camera, the farthest first: two passes of a radix sort over the bits of their depths. */
class DepthSorter {
  constructor(count) {
    this.depths = new Float32Array(count);
    this.bits = new Uint32Array(this.depths.buffer); // ascend as positive depths do
    this.indices = new Uint32Array(count);
    this.between = new Uint32Array(count);
    this.starts = new Uint32Array(65536);
  }

  sort(scene, view) {
    const stride = 4 * scene.texels;
    const [x, y, z] = view.axes[2];
    const shift = dot(view.axes[2], view.center);
    let kept = 0;
    for (let i = 0; i < scene.count; i++) {
      const at = i * stride;
      const depth = x * scene.numbers[at] + y * scene.numbers[at + 1] + z * scene.numbers[at + 2] - shift;
      if (depth < 0.01) continue;
      this.depths[i] = depth;
      this.indices[kept++] = i;
    }
    this.pass(this.indices, this.between, kept, 0);
    this.pass(this.between, this.indices, kept, 16);
    return this.indices.subarray(0, kept);
  }

  pass(source, target, count, shift) {
    const { starts, bits } = this;
    starts.fill(0);
    for (let i = 0; i < count; i++) starts[(bits[source[i]] >>> shift) & 65535]++;
    let sum = 0;
    for (let key = 65535; key >= 0; key--) {
      const found = starts[key];
      starts[key] = sum;
      sum += found;
    }
    for (let i = 0; i < count; i++) target[starts[(bits[source[i]] >>> shift) & 65535]++] = source[i];
  }
}
