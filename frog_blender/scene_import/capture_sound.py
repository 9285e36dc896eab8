"""A capture's sound in the sequencer, in time with the capture however it is retimed.

Blender can change a strip's speed, but follows no curve of time with it. So the sound itself is retimed
(``engine.source_media.retimed_sound``) and packed into the .blend as a WAV file; a strip plays it as it is. When the
timing has changed since, it is out of date until it is made again.
"""

import hashlib
import json
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import bpy

from ..capture_files import file_of, named_file
from ..engine.capture import media
from ..engine.errors import FrogError, brief
from ..engine.source_media.retimed_sound import heard_frames, retimed_sound
from ..engine.source_media.sound import FilmSound, Samples, check_length, find_sound, read_sound, wav_of
from ..timeline import playback
from ..timeline.frame_timing import frames_shown
from ..timeline.retiming import animated_paths, frame_rate, needs_evaluated_time, shown_curve
from .capture_objects import root_of

_MARK, _STAMP = "frog_capture", "frog_timing"
"""Of sounds that this file makes: the name of the capture then, and what its timing was."""
_TIMING = (
    *("start_frame", "speed", "repeat", "use_remap"),
    *("use_trim", "first_frame", "last_frame", "use_range", "range_start", "range_end"),
)
_STRIP_SETTINGS = ("name", "volume", "pan", "mute", "show_waveform")


@dataclass(frozen=True)
class MadeSound:
    """Attributes:
    sound: retimed.
    start: frame of the timeline at which it begins.
    frames: of the timeline that it lasts.
    """

    sound: Samples
    start: int
    frames: int


def sound_of(obj: bpy.types.Object) -> bpy.types.Sound | None:
    """The sound that was made of a capture and that something still plays, or None."""
    sound = obj.frog.sound
    if sound is None or not _is_played(sound):
        return None
    users = [other for other in playback.captures(bpy.data.objects) if other.frog.sound == sound]
    if len(users) < 2:
        return sound
    # Duplicates refer to it as well; the one that it was made for has the name that it had.
    owner = next((other for other in users if other.name == sound.get(_MARK)), users[0])
    return sound if owner == obj else None


def strips_of(sound: bpy.types.Sound, scene: bpy.types.Scene) -> list[bpy.types.SoundStrip]:
    """The strips of a scene that play a sound, those in meta strips included."""
    editor = scene.sequence_editor
    return [strip for strip in editor.strips_all if strip.type == "SOUND" and strip.sound == sound] if editor else []


def _is_played(sound: bpy.types.Sound) -> bool:
    return any(strips_of(sound, scene) for scene in bpy.data.scenes)


def is_outdated(obj: bpy.types.Object, scene: bpy.types.Scene) -> bool | None:
    """Whether a capture's sound was made for another timing; None where only Blender's evaluation of each frame could
    tell.
    """
    sound = sound_of(obj)
    if sound is None:
        return False
    curve = shown_curve(obj) if obj.frog.use_remap else None
    if needs_evaluated_time(obj) or (curve is not None and curve.modifiers):
        return None
    return bool(sound.get(_STAMP) != _stamp(obj, scene))


def _make(obj: bpy.types.Object, scene: bpy.types.Scene) -> MadeSound:
    """The sound of a capture as a scene's range of frames plays it.

    Raises:
        FrogError: if none is found, none can be heard, or it cannot be read.
    """
    header = playback.open_scene(file_of(obj)).header
    numbers = range(scene.frame_start, scene.frame_end + 1)
    shown, rate = frames_shown(obj, scene, numbers), frame_rate(scene)
    heard = heard_frames(shown, header.frame_count, rate / header.frames_per_second)
    if not heard:
        raise FrogError(
            f"{obj.name}: found nothing to hear in frames {scene.frame_start:,} to {scene.frame_end:,}, expected a "
            "range in which the capture plays."
        )
    film = find_sound(header, named_file(obj), has_sound)
    if film is None:
        raise FrogError(f"{obj.name}: found no film of its capture with sound, expected one.")
    read = _read(film, header.frame_count / header.frames_per_second)
    part = shown[heard.start : heard.stop]
    made = retimed_sound(read, part, rate, header.frame_count, header.frames_per_second)
    return MadeSound(made, numbers[heard.start], len(heard))


def place(scene: bpy.types.Scene, obj: bpy.types.Object) -> MadeSound:
    """Makes a capture's sound, packs it into the .blend and plays it by the strip that the capture's has in this scene,
    or by a new one.

    Raises:
        FrogError: if there is nothing to hear, it cannot be read, or a strip would lose what was done to it. Then
            nothing has changed.
    """
    made, old, unplayed = _make(obj, scene), sound_of(obj), obj.frog.sound
    strips = strips_of(old, scene) if old is not None else []
    for old_strip in strips:
        _check_replaceable(old_strip, strips, scene)
    name = f"{root_of(obj).name} Sound"
    with tempfile.TemporaryDirectory(prefix="frog-sound-") as folder:
        path = Path(folder) / f"{bpy.path.clean_name(name) or 'sound'}.wav"
        path.write_bytes(wav_of(made.sound))
        sound = bpy.data.sounds.load(str(path))
        sound.name = name
        sound.pack()
        sound.filepath = f"//{path.name}"
        sound[_MARK], sound[_STAMP] = obj.name, _stamp(obj, scene)
        obj.frog.sound = sound
        for replaced in strips or [None]:
            _put_strip(scene, sound, path, made, replaced)
    if unplayed is not None and not unplayed.users:
        bpy.data.sounds.remove(unplayed)
    return made


def _check_replaceable(strip: bpy.types.SoundStrip, strips: list[bpy.types.SoundStrip], scene: bpy.types.Scene) -> None:
    """FrogError for a strip to which something was done that ``_replace_strip`` would undo."""
    own = f'["{bpy.utils.escape_identifier(strip.name)}"].'
    done = {
        "that was cut or copied": len(strips) > 1,
        "that was trimmed": max(abs(strip.frame_offset_start), abs(strip.frame_offset_end)) >= 1,
        "that was retimed": len(strip.retiming_keys) > 0,
        "with modifiers": len(strip.modifiers) > 0,
        "with animated settings": any(own in path for path in animated_paths(scene)),
        "in a meta strip": scene.sequence_editor.strips.get(strip.name) != strip,
    }
    what = next((what for what, is_so in done.items() if is_so), None)
    if what is not None:
        raise FrogError(
            f"{strip.name}: found a strip {what}, which a new one would undo. Delete it in the sequencer first, and "
            "add the sound again."
        )


def _stamp(obj: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """Of all that a capture's sound depends on; of a time that needs evaluation, of all but that."""
    settings, render = obj.frog, scene.render
    values: list[object] = [getattr(settings, name) for name in _TIMING]
    values += [render.fps, render.fps_base, render.frame_map_old, render.frame_map_new]
    values += [scene.frame_start, scene.frame_end, named_file(obj).name]
    curve = shown_curve(obj) if settings.use_remap else None
    if settings.use_remap and curve is None:
        values.append(settings.shown_frame)
    elif curve is not None:
        for point in curve.keyframe_points:
            values += [*point.co, *point.handle_left, *point.handle_right, point.interpolation, point.easing]
        values.append(curve.extrapolation)
    return hashlib.blake2b(json.dumps(values).encode(), digest_size=16).hexdigest()


def _has_pyav() -> bool:
    return find_spec("av") is not None


def has_sound(film: Path) -> bool:
    """Whether a film has a track of sound: by PyAV where there is one, otherwise by Blender's own library."""
    if _has_pyav():
        return media.has_sound(film)
    import aud

    try:
        return bool(aud.Sound(str(film)).specs[1])
    except aud.error:
        return False


def _read(film: FilmSound, seconds: float) -> Samples:
    """A film's sound from the capture's beginning on: by PyAV where there is one, otherwise by Blender's own library,
    which does not know of a track that starts later than the images.
    """
    if _has_pyav():
        return read_sound(film.path, film.start, seconds)
    import aud

    check_length(film.path, seconds)
    begin = max(film.start, 0.0)
    try:
        sound = aud.Sound(str(film.path)).limit(begin, max(film.start + seconds, begin))
        return Samples(sound.data(), int(sound.specs[0])).part(film.start - begin, seconds)
    except aud.error as error:
        raise FrogError(f"{film.path}: its sound could not be read ({brief(error)}).") from error


def _put_strip(
    scene: bpy.types.Scene, sound: bpy.types.Sound, path: Path, made: MadeSound, replaced: bpy.types.SoundStrip | None
) -> None:
    """Adds a strip; in the place of another one, which keeps the length with which it was made, with its settings."""
    editor = scene.sequence_editor or scene.sequence_editor_create()
    settings, channel = {"name": sound.name}, max((strip.channel for strip in editor.strips), default=0) + 1
    if replaced is not None:
        settings, channel = {name: getattr(replaced, name) for name in _STRIP_SETTINGS}, replaced.channel
        editor.strips.remove(replaced)
    strip = editor.strips.new_sound(settings["name"], str(path), channel, made.start)
    loaded = strip.sound
    strip.sound = sound
    if loaded != sound and not loaded.users:
        bpy.data.sounds.remove(loaded)
    for name, value in settings.items():
        setattr(strip, name, value)
