"""The shaders: each capture's Gaussians projected into textures that all captures share, these splats into an image in
one order, and that image onto the viewport.

The first does what the engine's ``project_gaussian`` and ``make_splat`` do (engine/native/src/shared), the second what
``blend`` does: the same low-pass, cut-offs, linearisation and spherical harmonics.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gpu
from gpu_extras.batch import batch_for_shader

from ..engine import rasterizer
from ..engine.native.options import ALPHA_MAX, ALPHA_MIN
from .clouds import ROW
from .projection import NEAR

TEXTURES = ("means", "scales", "quaternions", "base", "sh")
"""In the order of their samplers: still ones, then moving ones."""
SPLATS = ("places", "conics", "colours")
"""Textures of what a view shows of each Gaussian, ROW of them in a row: its centre in pixels, its depth and whether it
is drawn; the root of its conic and the logarithm of its opacity; its colour."""
_CORNER = "corner"

_SHARED = (Path(rasterizer.__file__).parent / "projection.glsl").read_text(encoding="utf-8")
_CONSTANTS = f"""
const float ALPHA_MIN = {ALPHA_MIN!r};
const float ALPHA_MAX = {ALPHA_MAX!r};
const float NEAR = {NEAR!r};
const float LOG2E = 1.4426950408889634;
const int ROW = {ROW};
#define TEXEL(image, k) texelFetch(image, ivec2((k) % textureSize(image, 0).x, (k) / textureSize(image, 0).x), 0)
"""

_PROJECT_VERTEX = """
void main() {
  float row = rows.x + (0.5 * corner.y + 0.5) * rows.y;
  gl_Position = vec4(corner.x, 2.0 * row / rows.z - 1.0, 0.0, 1.0);
}
"""

_PROJECT_FRAGMENT = (
    _CONSTANTS
    + """
#define MOVING int(screen.z + 0.5)
#define LOW_PASS screen.w
#define SH_COUNT int(eye.w + 0.5)
#define THREE(image, k) vec3(TEXEL(image, k).r, TEXEL(image, (k) + 1).r, TEXEL(image, (k) + 2).r)

vec3 coefficient(int i, int k) {
  int at = 3 * (i * (SH_COUNT - 1) + k - 1);
  return i < MOVING ? THREE(sh_moving, at) : THREE(sh_still, at);
}

"""
    + _SHARED
    + """
void main() {
  place = vec4(0.0);
  conic = vec4(0.0);
  colour = vec4(0.0);
  int i = (int(gl_FragCoord.y) - int(rows.x + 0.5)) * ROW + int(gl_FragCoord.x);
  if (i >= int(rows.w + 0.5)) {
    return;
  }
  vec3 mean = i < MOVING ? THREE(means_moving, 3 * i) : THREE(means_still, 3 * i);
  vec4 base = i < MOVING ? TEXEL(base_moving, i) : TEXEL(base_still, i);
  vec4 there = vec4(mean, 1.0);
  vec3 local = vec3(dot(to_right, there), dot(to_down, there), dot(to_front, there));
  float opacity = min(base.a, 1.0);
  if (!(local.z >= NEAR && opacity > ALPHA_MIN)) {
    return;
  }
  vec3 scale = i < MOVING ? THREE(scales_moving, 3 * i) : THREE(scales_still, 3 * i);
  vec4 quaternion = i < MOVING ? TEXEL(quaternions_moving, i) : TEXEL(quaternions_still, i);
  mat3 axes = mat3(to_right.xyz, to_down.xyz, to_front.xyz);
  vec4 covariance = covariance_of(local, axes, quaternion, scale, lens, screen.xy);
  float yy = covariance.z, xy = covariance.y, determinant = covariance.w;
  if (!(determinant > 1e-12 && determinant < 1e30)) {
    return;
  }
  float depth = 0.5 + 0.5 * (clip.x * local.z + clip.y) / (clip.z * local.z + clip.w);
  place = vec4(lens.xy * local.xy / local.z + lens.zw, depth, 1.0);
  float along = sqrt(0.5 * LOG2E * yy / determinant);
  conic = vec4(along, -along * xy / yy, sqrt(0.5 * LOG2E / yy), log2(opacity));
  colour = vec4(colour_of(i, base.rgb, normalize(mean - eye.xyz)), 1.0);
}
"""
)

_SPLAT_VERTEX = (
    _CONSTANTS
    + """
void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: not drawn
  int i = int(TEXEL(order, gl_InstanceID).r + 0.5);
  ivec2 texel = ivec2(i % ROW, i / ROW);
  vec4 place = texelFetch(places, texel, 0);
  conic = texelFetch(conics, texel, 0);
  colour = texelFetch(colours, texel, 0).rgb;
  centre = place.xy;
  depth = place.z;
  if (place.w == 0.0) {
    return;
  }

  // The rectangle around the ellipse in which alpha is at least ALPHA_MIN, along its axes.
  float yy = 0.5 * LOG2E / (conic.z * conic.z), xy = -conic.y / conic.x * yy;
  float determinant = 0.5 * LOG2E * yy / (conic.x * conic.x), xx = (determinant + xy * xy) / yy;
  float middle_square = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float wide = middle_square + apart, narrow = determinant / wide;
  vec2 axis = xx >= yy ? vec2(0.5 * (xx - yy) + apart, xy) : vec2(xy, 0.5 * (yy - xx) + apart);
  axis = apart > 1e-9 ? normalize(axis) : vec2(1.0, 0.0);
  float reach = conic.w - log2(ALPHA_MIN);
  vec2 half_sides = sqrt(2.0 / LOG2E * reach * vec2(wide, narrow)) + 0.01;
  vec2 pixel = centre + corner.x * half_sides.x * axis + corner.y * half_sides.y * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * pixel.x / screen.x - 1.0, 1.0 - 2.0 * pixel.y / screen.y, 0.0, 1.0);
}
"""
)

_SPLAT_FRAGMENT = (
    _CONSTANTS
    + """
void main() {
  vec2 off = vec2(gl_FragCoord.x, screen.y - gl_FragCoord.y) - centre;
  float u = conic.x * off.x + conic.y * off.y, v = conic.z * off.y;
  float alpha = min(exp2(conic.w - u * u - v * v), ALPHA_MAX);
  ivec2 there = textureSize(scene_depth, 0);
  ivec2 texel = min(ivec2(gl_FragCoord.xy / screen.xy * vec2(there)), there - 1);
  bool is_behind = depth > texelFetch(scene_depth, texel, 0).r;
  if (alpha < ALPHA_MIN || is_behind != (screen.z > 0.5)) {
    discard;
  }
  fragColor = vec4(colour * alpha, alpha);
}
"""
)

_PICTURE_VERTEX = """
void main() {
  place = 0.5 * corner + 0.5;
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""

_PICTURE_FRAGMENT = """
vec3 looked_up(vec3 c) {
  int side = int(look.z + 0.5), width = textureSize(colors, 0).x;
  vec3 at = c * float(side - 1);
  ivec3 low = ivec3(min(at, vec3(float(side) - 1.5)));
  vec3 part = at - vec3(low), found = vec3(0.0);
  for (int k = 0; k < 8; k++) {
    ivec3 off = ivec3(k & 1, (k >> 1) & 1, k >> 2), texel = low + off;
    vec3 weight = mix(1.0 - part, part, vec3(off));
    int i = texel.x + side * (texel.y + side * texel.z);
    found += weight.x * weight.y * weight.z * texelFetch(colors, ivec2(i % width, i / width), 0).rgb;
  }
  return found;
}

vec3 decoded(vec3 c) {
  return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
}

vec3 encoded(vec3 c) {
  return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

void main() {
  vec4 found = texture(picture, place);
  float alpha = clamp(found.a, 0.0, 1.0);
  vec3 shown = clamp(found.rgb / max(alpha, 1e-6), 0.0, 1.0);
  vec3 linear = decoded(look.z > 0.0 ? looked_up(shown) : shown);
  if (look.x != 1.0 || look.y != 1.0) {
    linear = decoded(pow(clamp(encoded(linear * look.x), 0.0, 1.0), vec3(look.y)));
  }
  fragColor = vec4(linear * alpha, alpha);  // viewports encode what is drawn into them
}
"""


def projection_shader() -> gpu.types.GPUShader:
    """Writes rows of the textures ``SPLATS``: one capture's Gaussians, a pixel each."""
    constants = (
        *("to_right", "to_down", "to_front"),  # rows of the matrix from the capture's space to the camera's
        "lens",
        "clip",
        "eye",  # and the number of the colours' coefficients
        "screen",  # width, height, Gaussians of the moving textures, and the low-pass
        "rows",  # the first one, how many, those of the textures, and the number of Gaussians
    )  # 128 bytes, which every graphics card has
    return _made(
        dict.fromkeys(constants, "VEC4"),
        [f"{name}_{state}" for state in ("still", "moving") for name in TEXTURES],
        (_PROJECT_VERTEX, _PROJECT_FRAGMENT),
        outputs=("place", "conic", "colour"),
    )


def splat_shader() -> gpu.types.GPUShader:
    """Draws quads of two triangles, one instance a splat."""
    between = gpu.types.GPUStageInterfaceInfo("frog_splat")
    for name, kind in (("colour", "VEC3"), ("conic", "VEC4"), ("centre", "VEC2"), ("depth", "FLOAT")):
        between.flat(kind, name)
    constants = {"screen": "VEC3"}  # width, height, and 1 for what is hidden alone, 0 for the rest alone
    return _made(constants, [*SPLATS, "order", "scene_depth"], (_SPLAT_VERTEX, _SPLAT_FRAGMENT), between)


def fading_shader() -> gpu.types.GPUShader:
    """Writes a share everywhere."""
    vertex = f"void main() {{\n  gl_Position = vec4({_CORNER}, 0.0, 1.0);\n}}\n"
    return _made({"share": "FLOAT"}, [], (vertex, "void main() {\n  fragColor = vec4(share);\n}\n"))


def picture_shader() -> gpu.types.GPUShader:
    """Lays an image of splats, display-referred and premultiplied, over what is there."""
    between = gpu.types.GPUStageInterfaceInfo("frog_picture")
    between.smooth("VEC2", "place")
    constants = {"look": "VEC3"}  # a factor, an exponent, and the side of the table of colors; 0 for none
    return _made(constants, ["picture", "colors"], (_PICTURE_VERTEX, _PICTURE_FRAGMENT), between)


def square(shader: gpu.types.GPUShader) -> gpu.types.GPUBatch:
    """The corners (-1, -1) to (1, 1) for a shader of these."""
    return batch_for_shader(shader, "TRI_STRIP", {_CORNER: [(-1, -1), (1, -1), (-1, 1), (1, 1)]})


def _made(
    constants: dict[str, str],
    textures: Sequence[str],
    sources: tuple[str, str],
    between: Any = None,
    outputs: Sequence[str] = ("fragColor",),
) -> gpu.types.GPUShader:
    """A shader of a vertex's and a fragment's source.

    Args:
        constants: types by names.
        between: what the one gives to the other.
    """
    info = gpu.types.GPUShaderCreateInfo()
    for name, kind in constants.items():
        info.push_constant(kind, name)
    for slot, name in enumerate(textures):
        info.sampler(slot, "FLOAT_2D", name)
    for slot, name in enumerate(outputs):
        info.fragment_out(slot, "VEC4", name)
    info.vertex_in(0, "VEC2", _CORNER)
    if between is not None:
        info.vertex_out(between)
    vertex, fragment = sources
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    return gpu.shader.create_from_info(info)
