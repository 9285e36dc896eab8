"""ChArUco boards and checkerboards: described in a small TOML or JSON file, or found in images, layout included."""

import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Bools, Float64s, ImageArray, Ints
from ...errors import brief, found_instead
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, plain_json, text, whole
from ...io.regular_file import read_text
from ..synchronization.films import spread
from ..video import load_opencv, shrunk

_FAMILIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000")
"""ArUco's own dictionaries, each of which begins with the smaller ones of ``_SIZES``."""
_SIZES = (50, 100, 250, 1000)
_OTHERS = ("DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9", "DICT_ARUCO_MIP_36h12")
"""What is searched for besides; 16h5 and 36h10 are not (one finds them everywhere)."""
_MOST_SQUARES = 60
_SIDE, _IMAGES = 960, 24  # pixels of the longer side, and images, in which a layout is sought
_FIRST_SIDE, _FIRST_IMAGES = 640, 12  # the same for a first look, which tries everything
_FIRST_FOUND = 2  # images of the first look that must show something
_LEAST_MARKERS = 4  # in one image, for a homography that can be checked
_LEAST_AGREEING = 3  # images that must agree on a layout
_LAYOUT_RESIDUAL = 0.12  # of a square, the median marker's distance from where its layout says
_TRIALS = 200  # of a homography: nearly all markers must fit it
_SKEW = 0.15  # of a marker's side
_LEAST_CORNERS = 6
_MOST_BYTES = 2**16
_LARGEST = 10.0  # metres of a square
_UNITS = {"inch": 0.0254, "cm": 0.01}  # metres
_REACH = (2, 8)  # pixels about a ChArUco board's corner in which its place is refined


@dataclass(frozen=True)
class Board:
    """A flat calibration board.

    Attributes:
        columns, rows: squares.
        square: metres of a square's side; None where nobody knows, then lengths count squares.
        marker: a marker's side as a part of its square's; 0 for a checkerboard.
        dictionary: OpenCV's name of the markers' dictionary; "" for a checkerboard.
        inverted: white where a board is black.
        legacy: the pattern of OpenCV before 4.6, which begins with a white square where rows are even.
    """

    columns: int
    rows: int
    square: float | None = None
    marker: float = 0.75
    dictionary: str = ""
    inverted: bool = False
    legacy: bool = False

    @property
    def places(self) -> Float64s:
        """(N, 3) inner corners, row by row, metres or squares."""
        columns, rows = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        flat = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)])
        return flat.astype(np.float64) * (self.square or 1.0)

    def __str__(self) -> str:
        if not self.dictionary:
            return f"a checkerboard of {self.columns} x {self.rows} squares"
        kind = f"{', inverted' * self.inverted}{', legacy pattern' * self.legacy}"
        return f"a ChArUco board of {self.columns} x {self.rows} squares with {self.dictionary}{kind}"


class Corners(NamedTuple):
    """What was seen of a board in one image: (N,) corner numbers and (N, 2) pixels, pixel centres at +0.5.

    Of its markers: (N,) numbers and (N, 4, 2) pixels.
    """

    numbers: Ints
    pixels: Float64s


def find_corners(board: Board, images: Iterable[ImageArray | None]) -> Iterator[Corners | None]:
    """The board's inner corners in each image (H, W) or (H, W, 3); None where it was not found or hardly shows, and
    where there is no image."""
    find = _charuco_finder(board) if board.dictionary else partial(_checkerboard_corners, board)
    for image in images:
        corners = None if image is None else find(_gray(image, board.inverted))
        yield None if corners is None or _is_poor(board, corners) else corners


def find_board(images: Sequence[ImageArray]) -> Board | None:
    """The board that several of the images show, of unknown size; None where none does.

    ChArUco boards of the common dictionaries are found in both polarities and with both patterns; checkerboards where
    most images that show them show them whole.
    """
    few, more = ([images[index] for index in spread(len(images), most)] for most in (_FIRST_IMAGES, _IMAGES))
    first = [shrunk(_gray(image, False), _FIRST_SIDE) for image in few]
    second = [shrunk(_gray(image, False), _SIDE) for image in more]
    return _find_charuco(first, second) or _find_checkerboard(first, second)


def _gray(image: ImageArray, inverted: bool) -> ImageArray:
    gray = image if image.ndim == 2 else load_opencv().cvtColor(image, load_opencv().COLOR_RGB2GRAY)
    return np.ascontiguousarray(255 - gray if inverted else gray)


def _dictionary(name: str) -> Any:  # a cv2.aruco.Dictionary
    aruco = load_opencv().aruco
    return aruco.getPredefinedDictionary(getattr(aruco, name))


def charuco(board: Board) -> Any:  # a cv2.aruco.CharucoBoard
    """OpenCV's own of the same squares, each a unit long."""
    size, dictionary = (board.columns, board.rows), _dictionary(board.dictionary)
    made = load_opencv().aruco.CharucoBoard(size, 1.0, board.marker, dictionary)
    made.setLegacyPattern(board.legacy)
    return made


def _charuco_finder(board: Board) -> Any:  # a function of a gray image
    aruco = load_opencv().aruco
    parameters = aruco.CharucoParameters()
    parameters.minMarkers = 1  # a corner at the board's rim has one marker: wrong ones do not survive the adjustment
    detector = aruco.CharucoDetector(charuco(board), parameters)

    def find(gray: ImageArray) -> Corners | None:
        pixels, numbers, _, _ = detector.detectBoard(gray)
        if numbers is None or len(numbers) < _LEAST_CORNERS:
            return None
        corners = Corners(numbers.ravel().astype(np.int64), pixels.reshape(-1, 2).astype(np.float64))
        return _refined(board, gray, corners)

    return find


def _refined(board: Board, gray: ImageArray, corners: Corners) -> Corners | None:
    """ChArUco corners found once more, each within what its nearest markers leave free.

    OpenCV's detector counts from a pixel's corner in some versions and from its centre in others.
    """
    cv2 = load_opencv()
    places = replace(board, square=1.0).places[:, :2]
    homography, _ = cv2.findHomography(places[corners.numbers], corners.pixels, cv2.RANSAC, 5.0)
    if homography is None:
        return None
    steps = np.stack([places[corners.numbers] + step for step in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))])
    seen = cv2.perspectiveTransform(steps.reshape(1, -1, 2), homography).reshape(3, -1, 2)
    side = np.linalg.norm(seen[1:] - seen[0], axis=2).min(axis=0)
    reach = np.clip(0.45 * (1.0 - board.marker) * side, *_REACH).astype(int)
    refined = corners.pixels.copy()
    for distance in np.unique(reach).tolist():
        rows = reach == distance
        refined[rows] = _nearest_corners(gray, corners.pixels[rows], distance)
    stays = np.abs(refined - corners.pixels).max(axis=1) < reach
    return Corners(corners.numbers[stays], refined[stays] + 0.5)


def _nearest_corners(gray: ImageArray, pixels: Float64s, reach: int) -> Float64s:
    """(N, 2) the corners within so many pixels of each place, counted from the first pixel's centre."""
    cv2 = load_opencv()
    start = np.ascontiguousarray(pixels, np.float32).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    corners = cv2.cornerSubPix(gray, start, (reach, reach), (-1, -1), stop)
    return np.asarray(corners.reshape(-1, 2), np.float64)


def _checkerboard_corners(board: Board, gray: ImageArray) -> Corners | None:
    small = shrunk(gray, _SIDE)
    grid = _grid(board, small)
    if grid is None:
        return None
    scaled = (grid.reshape(-1, 2) + 0.5) * (gray.shape[1] / small.shape[1])
    if small is not gray:
        scaled = _nearest_corners(gray, scaled - 0.5, 5) + 0.5
    return Corners(np.arange(len(scaled)), scaled)


def _grid(board: Board, gray: ImageArray) -> Float64s | None:
    """(rows, columns, 2) a checkerboard's inner corners, in the one order; None where it does not show whole."""
    cv2, size = load_opencv(), (board.columns - 1, board.rows - 1)
    is_found, pixels = cv2.findChessboardCornersSB(gray, size, flags=cv2.CALIB_CB_ACCURACY)
    return _in_order(gray, pixels.reshape(*size[::-1], 2).astype(np.float64)) if is_found else None


def _in_order(gray: ImageArray, grid: Float64s) -> Float64s:
    """The corners (rows, columns, 2) in the one order: not mirrored, and the first cell between corners dark."""
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[::-1]
    return grid if _cell(gray, grid, 0, 0) < _cell(gray, grid, 0, 1) else grid[::-1, ::-1]


def _cell(gray: ImageArray, grid: Float64s, row: int, column: int) -> float:
    x, y = grid[row : row + 2, column : column + 2].mean((0, 1)).round().astype(int).tolist()
    return float(gray[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].mean())


def _is_poor(board: Board, corners: Corners) -> bool:
    """Too few corners for a pose, or all in one row or column."""
    lines = np.divmod(corners.numbers, board.columns - 1)
    return len(corners.numbers) < _LEAST_CORNERS or min(len(set(line.tolist())) for line in lines) < 2


def _find_charuco(first: list[ImageArray], second: list[ImageArray]) -> Board | None:
    counts: dict[tuple[str, bool], int] = {}
    for kind in product((*_FAMILIES, *_OTHERS), (False, True)):
        counts[kind] = len(list(_find_markers(kind[0], first, kind[1])))
        if 2 * counts[kind] > len(first):  # no other can show in as many
            break
    for name, inverted in sorted(counts, key=lambda kind: -counts[kind]):
        if counts[name, inverted] < _FIRST_FOUND:
            break
        layout = _layout(list(_find_markers(name, second, inverted)), name)
        if layout is not None:
            return replace(layout, inverted=inverted)
    return None


def _find_markers(name: str, grays: list[ImageArray], inverted: bool) -> Iterator[Corners]:
    """The markers of each image that shows enough of them."""
    detector = load_opencv().aruco.ArucoDetector(_dictionary(name))
    for gray in grays:
        pixels, numbers, _ = detector.detectMarkers(255 - gray if inverted else gray)
        if numbers is not None and len(numbers) >= _LEAST_MARKERS:
            yield Corners(numbers.ravel().astype(np.int64), np.array(pixels, np.float64).reshape(-1, 4, 2))


def _layout(images: list[Corners], name: str) -> Board | None:
    """The board on which the markers lie as they were seen, in at least three images and three in four."""
    if len(images) < _LEAST_AGREEING:
        return None
    seen, times = np.unique(np.concatenate([markers.numbers for markers in images]), return_counts=True)
    markers = 1 + int(seen[times >= min(_LEAST_AGREEING, max(times.max() // 4, 1))].max())
    shapes = ((columns, max(-(-2 * markers // columns), 2)) for columns in range(2, _MOST_SQUARES + 1))
    boards = [
        Board(columns, rows, dictionary=name, legacy=legacy)
        for columns, rows in shapes
        for legacy in ((False, True) if rows % 2 == 0 else (False,))
        if rows <= _MOST_SQUARES
    ]
    sides, board = max(((_marker_sides(board, images), board) for board in boards), key=lambda fit: len(fit[0]))
    if len(sides) < _LEAST_AGREEING:
        return None
    if name in _FAMILIES:  # fewer markers are harder to mistake
        size = next(size for size in _SIZES if size >= board.columns * board.rows // 2)
        name = f"{name.rsplit('_', 1)[0]}_{size}"
    return replace(board, marker=round(float(np.median(sides)), 3), dictionary=name)


def _marker_sides(board: Board, images: list[Corners]) -> list[float]:
    """The markers' side in squares in each image in which they lie as the board has them; none if a quarter do not."""
    sides: list[float] = []
    for index, markers in enumerate(images):
        side = _marker_side(board, markers)
        if side is not None:
            sides.append(side)
        elif 4 * (index + 1 - len(sides)) > len(images):
            return []
    return sides


def _marker_side(board: Board, markers: Corners) -> float | None:
    """Side of the markers in squares, if they lie as the board has them in this image."""
    places = np.array(charuco(board).getObjPoints(), np.float64).reshape(-1, 4, 3)[:, :, :2].mean(1)
    is_known: Bools = markers.numbers < len(places)
    numbers, pixels = markers.numbers[is_known], markers.pixels[is_known]
    if len(numbers) < _LEAST_MARKERS or len(set(numbers.tolist())) < len(numbers):
        return None
    cv2 = load_opencv()
    homography, _ = cv2.findHomography(pixels.mean(1), places[numbers], cv2.RANSAC, 0.3, maxIters=_TRIALS)
    if homography is None:
        return None
    corners = cv2.perspectiveTransform(pixels.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    off = np.linalg.norm(corners.mean(1) - places[numbers], axis=1)
    is_off = off > 3 * _LAYOUT_RESIDUAL
    # Two layouts may share most of their markers: a tenth at most may be misread.
    if np.median(off) > _LAYOUT_RESIDUAL or 10 * is_off.sum() > len(off) or not _is_wide(places[numbers]):
        return None
    # Sheared, one layout looks like another: the markers themselves must be upright squares in it.
    across, down = (np.median(corners[:, after] - corners[:, 0], axis=0) for after in (1, 3))
    side = float(across[0] + down[1]) / 2
    skew = max(abs(across[0] - side), abs(across[1]), abs(down[0]), abs(down[1] - side))
    return side if 0.3 <= side <= 0.98 and skew < _SKEW * side else None


def _is_wide(places: Float64s) -> bool:
    """Not all on one line, on which anything fits."""
    return bool(np.linalg.svd(places - places.mean(0), compute_uv=False)[1] > 0.5)


def _find_checkerboard(first: list[ImageArray], second: list[ImageArray]) -> Board | None:
    """The largest pattern that most images agree on, longer side across; it must be found again as it is."""
    cv2 = load_opencv()
    sizes = []
    for gray in first:
        is_found, _, grid = cv2.findChessboardCornersSBWithMeta(gray, (3, 3), cv2.CALIB_CB_LARGER)
        if is_found and sum(grid.shape) % 2:  # others look the same upside down
            sizes.append((max(grid.shape) + 1, min(grid.shape) + 1))
    for columns, rows in sorted(set(sizes), key=lambda size: (-sizes.count(size), -size[0] * size[1])):
        if sizes.count((columns, rows)) < _FIRST_FOUND:
            break
        board = Board(columns, rows, marker=0.0)
        if sum(_grid(board, gray) is not None for gray in second) >= _LEAST_AGREEING:
            return board
    return None


# --- boards described in files


def read_board(path: Path) -> Board:
    """The board of a TOML or JSON file.

    Either ``squares = [4, 5]`` (columns, rows), ``square_size`` and ``marker_size`` in metres (no marker: a
    checkerboard), ``dictionary = "DICT_4X4_50"``, and, where they are so, ``inverted = true`` and ``legacy = true``; or
    Caliscope's ``charuco.toml``: ``columns``, ``rows``, ``aruco_scale``, ``square_size_override_cm``, ``dictionary``,
    ``inverted``, ``legacy_pattern``; or a board of sleap-anipose (``board_x``, ``board_y``, ``square_length``,
    ``marker_length``, ``marker_bits``, ``dict_size``) or anipose (``board_type``, ``board_size`` ... in
    ``[calibration]``). Theirs are in millimetres, and a checkerboard's size counts inner corners.

    Raises:
        FrogError: if the file cannot be read, or describes no board.
    """
    content = read_text(path, "a board's description", _MOST_BYTES)
    try:
        values = plain_json(content, "a text") if path.suffix.lower() == ".json" else tomllib.loads(content)
        board = entries(values, "a board")
        board = entries(board.get("calibration", board), "calibration")
        if "board_x" in board or "board_size" in board:
            return _anipose(board)
        return _caliscope(board) if "columns" in board else _own_board(board)
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        expected = "a board: squares = [4, 5], square_size = 0.05"
        raise found_instead(path, f"no TOML ({brief(error)})", expected) from error


def _own_board(values: JsonObject) -> Board:
    squares = values.get("squares")
    if not isinstance(squares, list) or len(squares) != 2:
        raise UnfitValue(f"squares = {brief(squares)}", "the numbers of columns and rows, as in squares = [4, 5]")
    columns, rows = (whole(count, "a number of squares", 2, _MOST_SQUARES) for count in squares)
    square = number(values.get("square_size"), "square_size", 1e-4, _LARGEST)
    marker = 0.0
    if "marker_size" in values or "dictionary" in values:
        marker = number(values.get("marker_size"), "marker_size", 0.2 * square, 0.99 * square) / square
    return _checked(Board(columns, rows, square, marker), values)


def _caliscope(values: JsonObject) -> Board:
    columns, rows = (whole(values.get(key), key, 2, _MOST_SQUARES) for key in ("columns", "rows"))
    marker = number(values.get("aruco_scale"), "aruco_scale", 0.2, 0.99)
    if "square_size_override_cm" in values:
        square = number(values["square_size_override_cm"], "square_size_override_cm", 0.01, 100 * _LARGEST) / 100
    elif (unit := _UNITS.get(str(values.get("units")))) is not None:
        sides = (number(values.get(f"board_{side}"), f"board_{side}", 0.1, 1000) for side in ("width", "height"))
        square = unit * min(side / count for side, count in zip(sides, (columns, rows), strict=True))
    else:
        raise UnfitValue(f"units = {brief(values.get('units'))}", "inch or cm, or square_size_override_cm")
    return _checked(Board(columns, rows, square, marker), values | {"legacy": values.get("legacy_pattern", False)})


def _anipose(values: JsonObject) -> Board:
    """aniposelib gives OpenCV a checkerboard's size as that of its inner corners, whatever its comments say."""
    own = {key.removeprefix("board_"): value for key, value in values.items()}
    length = own.get("square_length", own.get("square_side_length"))  # sleap-anipose's, and anipose's
    square = number(length, "the length of a square in millimetres", 1.0, 1000 * _LARGEST)
    size = own.get("size", [own.get("x"), own.get("y")])
    kind = own.get("type", "charuco" if "marker_length" in own else "checkerboard")
    board: JsonObject = {"squares": size, "square_size": square / 1000}
    if kind == "checkerboard":
        corners = items(size, "numbers of inner corners", 2)
        board["squares"] = [whole(count, "one of them", 1, _MOST_SQUARES - 1) + 1 for count in corners]
    elif kind == "charuco":
        marker = number(own.get("marker_length"), "the length of a marker in millimetres", 0.1, square)
        bits, count = own.get("marker_bits"), own.get("dict_size", own.get("marker_dict_number"))
        board |= {"marker_size": marker / 1000, "dictionary": f"DICT_{bits}X{bits}_{count}"}
    else:
        raise UnfitValue(f"board_type = {brief(kind)}", "charuco or checkerboard")
    return _own_board(board)


def _checked(board: Board, values: JsonObject) -> Board:
    """The board with its other values, if they go together."""
    shape = f"{board.columns} x {board.rows} squares"
    if not board.marker and (board.columns + board.rows) % 2 == 0:
        ambiguous = f"a checkerboard of {shape}, which looks the same upside down"
        raise UnfitValue(ambiguous, "an odd and an even number of squares")
    if (board.columns - 1) * (board.rows - 1) < 4:
        raise UnfitValue(f"a board of {shape}", "four inner corners or more")
    dictionary = ""
    if board.marker:
        name = text(values.get("dictionary"), "dictionary", 64)
        known = {known.lower(): known for known in dir(load_opencv().aruco) if known.startswith("DICT_")}
        if name.lower() not in known:
            raise UnfitValue(f"dictionary = {brief(name)}", "one of OpenCV's, such as DICT_4X4_50")
        dictionary = known[name.lower()]
        if len(_dictionary(dictionary).bytesList) < board.columns * board.rows // 2:
            raise UnfitValue(f"{dictionary} for {shape}", "a larger dictionary")
    return replace(board, dictionary=dictionary, inverted=_flag(values, "inverted"), legacy=_flag(values, "legacy"))


def _flag(values: JsonObject, key: str) -> bool:
    value = values.get(key, False)
    if type(value) is not bool:
        raise UnfitValue(f"{key} = {brief(value)}", "true or false")
    return value
