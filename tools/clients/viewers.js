// Each viewer of the web draws one file from one camera; window.draw(job) resolves once the file is loaded and drawn
// again and again, and fails with what the viewer says. A job has the viewer's name, the file's url, the vertical field
// of view in degrees, and the camera's (4, 4) matrix to the file's axes: x right, y up, z back, column after column.
// Then window.look(matrix) moves the camera. A job that is there before the page, window.job, is drawn at once.

const root = document.getElementById("root");
const NEAR = 0.01, FAR = 1000;
const LOW_PASS = 0.3;

/** Moves a camera of three.js, which nothing but its matrix places. */
function place(camera, matrix) {
  camera.matrixWorld.fromArray(matrix);
  camera.matrixWorld.decompose(camera.position, camera.quaternion, camera.scale);
}

function placed(three, job) {
  const camera = new three.PerspectiveCamera(job.fov, innerWidth / innerHeight, NEAR, FAR);
  place(camera, job.matrix);
  return camera;
}

function webgl(three) {
  const renderer = new three.WebGLRenderer({ antialias: false });
  renderer.setPixelRatio(1);
  renderer.setSize(innerWidth, innerHeight);
  root.append(renderer.domElement);
  return renderer;
}

/** Spark's own low-pass takes from the opacity, as for scenes that were trained with anti-aliasing. */
async function spark(job) {
  const three = await import("three");
  const { SparkRenderer, SplatMesh } = await import("spark");
  const renderer = webgl(three), scene = new three.Scene(), camera = placed(three, job);
  scene.add(new SparkRenderer({ renderer, preBlurAmount: LOW_PASS, blurAmount: 0 }));
  const mesh = new SplatMesh({ url: job.url });
  await mesh.initialized;
  scene.add(mesh);
  renderer.setAnimationLoop(() => renderer.render(scene, camera));
  return matrix => place(camera, matrix);
}

async function gaussianSplats3D(job) {
  const three = await import("three");
  const { SceneRevealMode, Viewer } = await import("gaussian-splats-3d");
  const camera = placed(three, job);
  const viewer = new Viewer({
    renderer: webgl(three), camera, useBuiltInControls: false, sharedMemoryForWorkers: false,
    sphericalHarmonicsDegree: 2, sceneRevealMode: SceneRevealMode.Instant,
  });
  await viewer.addSplatScene(job.url, { showLoadingUI: false, splatAlphaRemovalThreshold: 0, progressiveLoad: false });
  viewer.start();
  return matrix => place(camera, matrix);
}

async function playcanvas(job) {
  const pc = await import("playcanvas");
  const canvas = document.createElement("canvas");
  root.append(canvas);
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false, alpha: false } });
  app.setCanvasFillMode(pc.FILLMODE_FILL_WINDOW);
  app.setCanvasResolution(pc.RESOLUTION_AUTO);
  app.graphicsDevice.maxPixelRatio = 1;
  app.start();
  const name = job.url.split("/").pop();
  const asset = new pc.Asset(name, name.endsWith(".glb") ? "container" : "gsplat", { url: job.url, filename: name });
  await new Promise((done, fail) => {
    asset.once("load", done);
    asset.once("error", message => fail(new Error(String(message))));
    app.assets.add(asset);
    app.assets.load(asset);
  });
  let splats;
  if (asset.type === "container") splats = asset.resource.instantiateRenderEntity();
  else {
    splats = new pc.Entity();
    splats.addComponent("gsplat", { asset });
  }
  app.root.addChild(splats);
  const camera = new pc.Entity();
  const seen = { fov: job.fov, nearClip: NEAR, farClip: FAR, clearColor: new pc.Color(0, 0, 0) };
  camera.addComponent("camera", { ...seen, toneMapping: pc.TONEMAP_LINEAR });
  const look = numbers => {
    const matrix = new pc.Mat4().set(numbers);
    camera.setPosition(matrix.getTranslation());
    camera.setRotation(new pc.Quat().setFromMat4(matrix));
  };
  look(job.matrix);
  app.root.addChild(camera);
  return look;
}

/** The splats of three.js itself, by its newer renderer on WebGL 2. They are sorted and drawn in the same frame, which
 * takes seconds in software; their colours are for the display already. */
async function three(job) {
  const three = await import("three/webgpu");
  const { GaussianSplat } = await import("three/addons/objects/GaussianSplat.js");
  const renderer = new three.WebGPURenderer({ antialias: false, forceWebGL: true });
  renderer.setPixelRatio(1);
  renderer.setSize(innerWidth, innerHeight);
  renderer.outputColorSpace = three.LinearSRGBColorSpace;
  root.append(renderer.domElement);
  await renderer.init();
  const scene = new three.Scene(), camera = placed(three, job);
  if (job.url.endsWith(".glb")) {
    const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
    const plugin = await import("three/addons/loaders/GLTFGaussianSplatLoaderExtension.js");
    const loader = new GLTFLoader().register(parser => new plugin.GLTFGaussianSplatLoaderExtension(parser));
    scene.add((await loader.loadAsync(job.url)).scene);
  } else {
    const { SPZLoader } = await import("three/addons/loaders/SPZLoader.js");
    const { GaussianSplatPLYLoader } = await import("three/addons/loaders/GaussianSplatPLYLoader.js");
    const loader = job.url.endsWith(".spz") ? new SPZLoader() : new GaussianSplatPLYLoader();
    scene.add(new GaussianSplat(await loader.loadAsync(job.url)));
  }
  for (let frame = 0; frame < 3; frame++) {
    await new Promise(requestAnimationFrame);
    renderer.render(scene, camera);
  }
}

const VIEWERS = { "Spark": spark, "GaussianSplats3D": gaussianSplats3D, "PlayCanvas": playcanvas, "three.js": three };
window.draw = async job => { window.look = await VIEWERS[job.viewer](job); };
document.documentElement.dataset.ready = "";
if (window.job) window.draw(window.job);
