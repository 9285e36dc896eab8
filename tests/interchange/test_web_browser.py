"""The web page in a real browser without a window (make test-web): images, hands on it, and no request."""

import functools
import os
import re
import shutil
import threading
from base64 import b64decode
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.evaluation.metrics import psnr_of
from frog_blender.engine.interchange.take import scene_take
from frog_blender.engine.interchange.web_page.page import write_page
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image

pytestmark = pytest.mark.slow
CHROMIUM = os.environ.get("FROG_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
OPTIONS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDTH, HEIGHT = 320, 240
FRAMES = range(7)


@pytest.fixture(scope="module")
def scene() -> ScenePlayer:
    return ScenePlayer(scene_file(count=600, sh_count=16, moving=200))


@pytest.fixture(scope="module")
def address(scene: ScenePlayer, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "x.html"
    list(write_page(path, scene_take(scene, "x", FRAMES)))
    return path.as_uri()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (make test-web)")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium; FROG_CHROMIUM names one")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """Fails at its end for any error in the page, and any request but for the page itself and its worker."""
    context = browser.new_context(viewport={"width": WIDTH, "height": HEIGHT}, has_touch=True)
    page = context.new_page()
    errors: list[str] = []
    asked: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: asked.append(request.url.partition("#")[0].rpartition("/")[2]))
    yield page
    context.close()
    assert not errors
    assert all(name.startswith(("x.html", "scene.bin")) or re.fullmatch(r"[0-9a-f-]{36}", name) for name in asked)


def shown(page: Any) -> str:
    """The camera and the frame of what is drawn."""
    page.wait_for_selector("html[data-shown], html[data-failed]", state="attached")
    assert page.evaluate("document.documentElement.dataset.failed") is None
    return str(page.evaluate("document.documentElement.dataset.shown"))


def image(page: Any) -> np.ndarray:
    """(H, W, 3) uint8 of the canvas once nothing moves."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    page.wait_for_selector("html.still", state="attached")
    return canvas(page)


def canvas(page: Any) -> np.ndarray:
    """(H, W, 3) uint8 of it as it is."""
    content = page.evaluate("document.getElementById('canvas').toDataURL()")
    decoded = cv2.imdecode(np.frombuffer(b64decode(content.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert decoded.std() > 10
    return decoded[:, :, ::-1]


@pytest.mark.parametrize("frame", [0, 3, 6])
def test_images_are_the_engines(page: Any, scene: ScenePlayer, address: str, frame: int) -> None:
    for camera in scene.header.cameras:
        page.goto(f"{address}#camera={camera.name}&frame={frame}&plain")
        page.reload()  # the address behind # alone loads nothing anew
        assert shown(page) == f"{camera.name} {frame}"
        scale = min(WIDTH / camera.width, HEIGHT / camera.height)
        large = camera.resized(round(camera.width * scale), round(camera.height * scale))
        expected = render_image(scene.at_frame(frame), large, scene.header.background)
        actual = image(page)
        top, left = (HEIGHT - large.height) // 2, (WIDTH - large.width) // 2
        actual = actual[top : top + large.height, left : left + large.width]
        error = (actual.astype(float) - expected) / 255
        assert expected.std() > 20
        assert psnr_of(float((error**2).mean())) > 36, (camera.name, frame)


def test_mouse_wheel_touch_and_keys(page: Any, scene: ScenePlayer, address: str) -> None:
    page.goto(f"{address}#frame=2")
    first = scene.header.cameras[0].name
    assert shown(page) == f"{first} 2"
    seen = [image(page)]

    def differs() -> bool:
        for _ in range(20):  # a browser hands wheels and fingers on when it likes
            now = image(page)
            if np.abs(now.astype(int) - seen[-1]).mean() > 1:
                seen.append(now)
                return True
        return False

    page.mouse.move(160, 100)
    page.mouse.down()
    page.mouse.move(220, 110, steps=3)
    page.mouse.up()
    assert differs(), "dragging turns"
    page.mouse.wheel(0, 300)
    assert differs(), "the wheel goes away"
    page.mouse.down(button="right")
    page.mouse.move(180, 60, steps=3)
    page.mouse.up(button="right")
    assert differs(), "the right button moves sideways"
    page.keyboard.press("Home")
    image(page)
    np.testing.assert_array_equal(image(page), seen[0], err_msg="Home is where one began")
    page.keyboard.press("ArrowRight")
    image(page)
    assert shown(page) == f"{first} 3"
    for index, key in ((1, "c"), (2, "Shift+C")):
        page.keyboard.press(key)
        image(page)
        assert shown(page) == f"{scene.header.cameras[index].name} 3"
    seen.append(image(page))
    touches = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[int, int]) -> None:
        touches.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    for fingers in ([(100, 100)], [(100, 100), (200, 100)]):
        touch("touchStart", *fingers)
        for step in (10, 20, 30):
            touch("touchMove", *((x + (1 if x > 100 else -1) * step, y + step // 2) for x, y in fingers))
        touch("touchEnd")
        assert differs(), f"{len(fingers)} fingers"


def test_it_plays_and_pauses(page: Any, address: str) -> None:
    page.goto(f"{address}#frame=0")
    shown(page)
    page.click("#play")
    frames = set()  # polled: the page's policy forbids what wait_for_function would run in it
    for _ in range(200):
        frames.add(float(shown(page).rpartition(" ")[2]))
        if len(frames) > 3:
            break
        page.wait_for_timeout(50)
    assert len(frames) > 3 and max(frames) <= 6
    page.keyboard.press(" ")
    image(page)
    still = shown(page)
    page.wait_for_timeout(300)
    assert shown(page) == still


def test_slow_frames_have_fewer_pixels_until_they_stand(page: Any, address: str) -> None:
    page.add_init_script(
        "const soon = requestAnimationFrame; window.requestAnimationFrame = (f) => setTimeout(() => soon(f), 60);"
        "window.widths = []; const draw = WebGL2RenderingContext.prototype.viewport;"
        "WebGL2RenderingContext.prototype.viewport = function (...a) { widths.push(a[2]); draw.apply(this, a); };"
    )
    page.goto(f"{address}#frame=3")
    sharp = image(page)
    page.click("#play")
    while min(page.evaluate("widths")) > WIDTH / 2:
        page.wait_for_timeout(100)
    page.click("#play")
    page.reload()
    np.testing.assert_array_equal(image(page), sharp)
    assert page.evaluate("widths.at(-1)") == WIDTH


def test_lost_graphics_come_back(page: Any, address: str) -> None:
    page.goto(f"{address}#frame=3")
    before = image(page)
    page.evaluate(
        "window.card = document.getElementById('canvas').getContext('webgl2').getExtension('WEBGL_lose_context');"
        "card.loseContext()"
    )
    page.wait_for_selector("#again", state="visible")
    assert "lost its graphics" in page.inner_text("#told") and page.is_visible("#poster")
    page.evaluate("card.restoreContext()")
    page.wait_for_selector("#poster", state="hidden")
    assert page.is_hidden("#told")
    np.testing.assert_array_equal(image(page), before)
    page.evaluate("card.loseContext()")
    page.click("#again")
    page.wait_for_selector("html.still", state="attached")
    np.testing.assert_array_equal(image(page), before)


def test_without_webgl_2_there_is_a_picture(page: Any, address: str, scene: ScenePlayer) -> None:
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(address)
    page.wait_for_selector("html[data-failed]", state="attached")
    assert "no WebGL 2" in page.inner_text("#told")
    assert page.is_hidden("#bar") and page.is_hidden("#canvas") and page.is_hidden("#again")
    content = b64decode(page.get_attribute("#poster", "src").partition(",")[2])
    poster = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    expected = render_image(scene.at_frame(0), scene.header.cameras[0], scene.header.background)
    assert psnr_of(float((((poster.astype(float) - expected) / 255) ** 2).mean())) > 25


@pytest.mark.parametrize("size", [(280, 653), (390, 844), (1280, 720)])
def test_controls_fit(page: Any, address: str, size: tuple[int, int]) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.goto(f"{address}#frame=3")
    image(page)
    boxes = [
        box for name in ("play", "time", "cameras", "reset", "full") if (box := page.locator(f"#{name}").bounding_box())
    ]
    for box in boxes:
        assert box["x"] >= 0 and box["x"] + box["width"] <= size[0] and box["y"] + box["height"] <= size[1]
        assert box["width"] >= 32 and box["height"] >= 30
    assert boxes[1]["width"] > 200  # of time
    assert boxes[0]["y"] - boxes[1]["y"] < 100


def test_a_folder_plays_while_it_arrives(page: Any, scene: ScenePlayer, address: str, tmp_path: Path) -> None:
    list(write_page(tmp_path / "x.html", scene_take(scene, "x", FRAMES), folder=True))
    (tmp_path / "x.html" / "index.html").rename(tmp_path / "x.html" / "x.html")
    handler = functools.partial(SimpleHTTPRequestHandler, directory=tmp_path / "x.html")
    network = page.context.new_cdp_session(page)
    network.send("Network.enable")
    slow = {"offline": False, "latency": 0, "downloadThroughput": 20_000, "uploadThroughput": 20_000}
    network.send("Network.emulateNetworkConditions", slow)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever).start()
        page.goto(f"http://127.0.0.1:{server.server_port}/x.html#frame=6")
        shown(page)
        assert 0 < page.evaluate("document.getElementById('loading').value") < 1
        actual = image(page)
        (tmp_path / "x.html" / "scene.bin").unlink()
        page.reload()
        page.wait_for_selector("html[data-failed]", state="attached")
        assert "cannot be fetched from here" in page.inner_text("#told")
        server.shutdown()
    page.goto(f"{address}#frame=6")
    np.testing.assert_array_equal(image(page), actual)


HEADSET = """
const clock = requestAnimationFrame, half = innerWidth / 2, height = innerHeight;
const wide = 1.2 * height / half;  // of the projection: 1.2 / 2 of the height is the focal length
const views = [-0.1, 0.1].map((x, index) => ({
  transform: { matrix: new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, 0.05, 0, 1]) },
  projectionMatrix: new Float32Array([wide, 0, 0, 0, 0, 1.2, 0, 0, 0.1, -0.2, -1, -1, 0, 0, -0.1, 0]),
  box: { x: half * index, y: 0, width: half, height },
}));
class Session extends EventTarget {
  updateRenderState() {}
  async requestReferenceSpace(kind) { return kind; }
  requestAnimationFrame(draw) {
    this.drawn = (this.drawn ?? 0) + 1;
    clock((now) => draw(now, { getViewerPose: () => ({ views }) }));
  }
}
const session = window.session = new Session();
const xr = { isSessionSupported: async (mode) => mode === "immersive-vr", requestSession: async () => session };
Object.defineProperty(navigator, "xr", { value: xr });
WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
window.XRWebGLLayer = class { framebuffer = null; getViewport(view) { return view.box; } };
"""


def test_a_headset_sees_with_two_eyes(page: Any, address: str, scene: ScenePlayer) -> None:
    page.add_init_script(HEADSET)
    page.goto(f"{address}#frame=3")
    before = image(page)
    assert page.is_hidden("#AR")
    page.evaluate("page.sharpness = 1; page.keep_pace = () => {}; 0")  # all pixels, however slow
    page.click("#VR")
    while page.evaluate("session.drawn ?? 0") < 20:
        page.wait_for_timeout(50)
    both = canvas(page)
    right, up, center, target = np.array(
        page.evaluate("[page.view.axes[0], page.view.up, page.view.center, page.view.target]")
    )
    back = np.cross(right, up)
    axes = np.array([np.cross(up, back), -up, -back])
    for eye, x in enumerate((-0.1, 0.1)):
        pose = np.eye(4)
        pose[:3, :3] = axes
        pose[:3, 3] = -axes @ center - np.array([x, -0.05, 0]) * np.linalg.norm(center - target) / 2  # 2 metres
        lens = np.array([[0.6 * HEIGHT, 0, 0.45 * WIDTH / 2], [0, 0.6 * HEIGHT, 0.4 * HEIGHT], [0, 0, 1]])
        expected = render_image(
            scene.at_frame(3), Camera("eye", WIDTH // 2, HEIGHT, lens, pose), scene.header.background
        )
        actual = both[:, eye * WIDTH // 2 : (eye + 1) * WIDTH // 2]
        assert psnr_of(float((((actual.astype(float) - expected) / 255) ** 2).mean())) > 30, eye
    page.evaluate("session.dispatchEvent(new Event('end'))")
    np.testing.assert_array_equal(image(page), before)


def test_a_damaged_page_says_so(page: Any, address: str, tmp_path: Path) -> None:
    text = Path(address.removeprefix("file://")).read_text(encoding="utf-16")
    mark = "<script>arrived()</script>"
    begin = text.rindex('"text/plain">', 0, text.index(mark)) + len('"text/plain">')
    (tmp_path / "x.html").write_text(text[:begin] + "AAAA" + text[begin + 4 :], encoding="utf-16")
    page.goto((tmp_path / "x.html").as_uri())
    page.wait_for_selector("html[data-failed]", state="attached")
    assert page.inner_text("#told")
