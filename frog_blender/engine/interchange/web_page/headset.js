// In a headset or through a phone's camera, by WebXR. Its axes: x right, y up, z backwards; metres.

const METRES = 2; // from the head to what the view turns about, at first

class Headset {
  /** Adds buttons for what the device can do. */
  static async offer(bar, begin) {
    for (const [mode, name] of [["immersive-vr", "VR"], ["immersive-ar", "AR"]]) {
      if (!(await navigator.xr?.isSessionSupported(mode).catch(() => false))) continue;
      const button = document.createElement("button");
      button.textContent = button.id = name;
      button.addEventListener("click", () => begin(mode));
      bar.append(button);
    }
  }

  static async begin(mode, gl, view) {
    const headset = new Headset();
    headset.session = await navigator.xr.requestSession(mode);
    await gl.makeXRCompatible();
    headset.layer = new XRWebGLLayer(headset.session, gl, { antialias: false }); // it is copied into
    headset.session.updateRenderState({ baseLayer: headset.layer });
    headset.space = await headset.session.requestReferenceSpace("local");
    headset.clear = mode === "immersive-ar";
    const back = unit(cross(view.axes[0], view.up));
    headset.world = [cross(view.up, back), view.up, back];
    headset.start = view.center;
    headset.scale = Math.hypot(...plus(view.center, view.target, -1)) / METRES;
    headset.exposure = view.exposure;
    return headset;
  }

  /** A view for each eye, and where it is drawn. */
  eyes(frame) {
    const { layer, world, exposure, clear } = this;
    return (frame.getViewerPose(this.space)?.views ?? []).map((eye) => {
      const { matrix } = eye.transform;
      const projection = eye.projectionMatrix;
      const column = (k) => [0, 1, 2].map((i) => dot(matrix.slice(k, k + 3), world.map((axis) => axis[i])));
      const { x, y, width, height } = layer.getViewport(eye);
      return {
        axes: [column(0), column(4).map((value) => -value), column(8).map((value) => -value)],
        center: plus(this.start, column(12), this.scale),
        exposure,
        intrinsics: (w, h) => [projection[0] * w, projection[5] * h, (1 - projection[8]) * w, (1 + projection[9]) * h]
          .map((value) => value / 2),
        pane: { framebuffer: layer.framebuffer, x, y, width, height, clear },
      };
    });
  }
}
