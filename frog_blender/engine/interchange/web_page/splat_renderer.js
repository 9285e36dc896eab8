// Draws Gaussians with WebGL 2 as the FROG engine does: sorted by depth, blended back to front.

const BATCH = 1024; // splats in an instance: one each is slow, most of all without a graphics card

const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D numbers;
uniform highp usampler2D order; // the Gaussians, the farthest first
uniform int kept;          // how many of them
uniform mat3 axes;         // the camera's, as rows of the matrix to there
uniform vec3 center;       // of the camera
uniform vec4 intrinsics;   // fx, fy, cx, cy in pixels
uniform vec2 size;         // of the canvas in pixels
uniform int texels, coefficients;
uniform vec3 exposure;
uniform float lowPass;     // variance that is added to splats, in pixels squared
flat out vec3 conic;
flat out vec4 color;
out vec2 offset;           // pixels from the splat's middle

#define LOW_PASS lowPass
#define SH_COUNT coefficients

ivec2 at(int place) {
  int row = textureSize(numbers, 0).x;
  return ivec2(place % row, place / row);
}

vec4 texel(int i, int which) { return texelFetch(numbers, at(i * texels + which), 0); }

vec3 coefficient(int i, int k) { return texel(i, 3 + k).rgb; }

${document.getElementById("projection").textContent}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside
  int turn = gl_InstanceID * ${BATCH} + gl_VertexID / 4;
  if (turn >= kept) return;
  int i = int(texelFetch(order, at(turn), 0).r);
  vec4 place = texel(i, 0);
  vec3 away = place.xyz - center, local = away * axes;
  float opacity = min(place.w, 1.0);
  if (local.z < 0.01 || opacity <= 1.0 / 255.0) return;
  vec4 covariance = covariance_of(local, axes, texel(i, 1), texel(i, 2).xyz, intrinsics, size);
  float xx = covariance.x, xy = covariance.y, yy = covariance.z;
  conic = vec3(yy, -xy, xx) / covariance.w;
  vec2 reach = sqrt(2.0 * log(opacity * 255.0) * vec2(xx, yy)); // where alpha falls below 1 / 255
  vec2 middle = intrinsics.xy * local.xy / local.z + intrinsics.zw;
  if (any(lessThan(middle + reach, vec2(0.0))) || any(greaterThan(middle - reach, size))) return;
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  offset = corner * (reach + 0.5);
  color = vec4(colour_of(i, texel(i, 3).rgb, normalize(away)) * exposure, opacity);
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

class SplatRenderer {
  /** Throws an Error with a sentence where the browser cannot draw. */
  constructor(canvas, scene) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser offers no WebGL 2, which this page draws with.");
    this.gl = gl;
    this.canvas = canvas;
    this.scene = scene;
    this.kept = 0; // Gaussians to draw
    this.prepare();
  }

  /** What the card needs before the numbers: at first, and after it has forgotten all. */
  prepare() {
    const { gl, scene } = this;
    // Sums of many splats need more than eight bits, and may exceed 1 before they are covered.
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float"))
      throw new Error("This browser's WebGL draws into no half floats, which this page needs.");
    this.splats = this.program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    gl.useProgram(this.splats);
    const [row, rows] = scene.texture;
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE))
      throw new Error(`This device has room for fewer than the scene's ${scene.count.toLocaleString()} Gaussians.`);
    for (const [unit, kind, height] of [[0, gl.RGBA32F, rows], [1, gl.R32UI, Math.ceil(scene.count / row)]]) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texStorage2D(gl.TEXTURE_2D, 1, kind, row, height);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    const corners = Uint16Array.from({ length: 6 * BATCH }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    // Drawn into first: a canvas has eight bits.
    this.buffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    const target = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, target);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, target);
    this.width = this.height = 0;
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
    return program;
  }

  /** Hands the first rows of the numbers to the card, and the order in which to draw. */
  upload({ rows, numbers, order, kept }) {
    const { gl } = this;
    const [row] = this.scene.texture;
    gl.activeTexture(gl.TEXTURE0);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, row, rows, gl.RGBA, gl.FLOAT, numbers);
    gl.activeTexture(gl.TEXTURE1);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, row, Math.ceil(kept / row), gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    this.kept = kept;
  }

  /**
   * Draws a view where it wants to be, on the canvas else, with a share of the pixels along each side.
   * True unless the browser has lost its graphics.
   */
  draw(view, sharpness) {
    const { gl, scene } = this;
    if (gl.isContextLost()) return false;
    // Asked for no sooner: the browser compiles meanwhile.
    this.linked ||= gl.getProgramParameter(this.splats, gl.LINK_STATUS);
    if (!this.linked)
      throw new Error(`This device's WebGL cannot draw the scene (${gl.getProgramInfoLog(this.splats)}).`);
    const pane = view.pane ?? { framebuffer: null, x: 0, y: 0, width: this.canvas.width, height: this.canvas.height };
    const [width, height] = [pane.width, pane.height].map((side) => Math.ceil(side * sharpness));
    if (this.width < pane.width || this.height < pane.height) {
      [this.width, this.height] = [Math.max(this.width, pane.width), Math.max(this.height, pane.height)];
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA16F, this.width, this.height);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.viewport(0, 0, width, height);
    const [red, green, blue] = scene.background.map((value, channel) => value * view.exposure[channel]);
    gl.clearColor(...(pane.clear ? [0, 0, 0, 0] : [red, green, blue, 1]));
    gl.clear(gl.COLOR_BUFFER_BIT);
    const at = (name) => gl.getUniformLocation(this.splats, name);
    gl.uniformMatrix3fv(at("axes"), false, view.axes.flat());
    gl.uniform3fv(at("center"), view.center);
    gl.uniform4fv(at("intrinsics"), view.intrinsics(width, height));
    gl.uniform2f(at("size"), width, height);
    gl.uniform1i(at("order"), 1);
    gl.uniform1i(at("texels"), scene.texels);
    gl.uniform1i(at("coefficients"), scene.sh_count);
    gl.uniform3fv(at("exposure"), view.exposure);
    gl.uniform1f(at("lowPass"), scene.low_pass);
    gl.uniform1i(at("kept"), this.kept);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(this.kept / BATCH));
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, pane.framebuffer);
    const corners = [pane.x, pane.y, pane.x + pane.width, pane.y + pane.height];
    gl.blitFramebuffer(0, 0, width, height, ...corners, gl.COLOR_BUFFER_BIT, gl.LINEAR);
    return true;
  }
}
