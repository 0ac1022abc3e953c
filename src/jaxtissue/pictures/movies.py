"""Movies of scenes, as GIF or MP4, and turntables: a scene from all round."""

import math
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from jaxtissue.system.extras import optional

FRAMES = 36  # of a turntable
SMALLER = 2  # times, a turntable than other pictures, if it is a GIF
_FILLED = 0.95  # of the picture, by the scene


def turn_round(plotter: Any, frames: int = FRAMES) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Look at a scene from all round, at equal angles about the direction that is up in its picture."""
    low, high = np.reshape(plotter.bounds, (3, 2)).T
    middle = (low + high) / 2
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    up = np.array(plotter.camera.up) / np.linalg.norm(plotter.camera.up)
    away = np.array(plotter.camera.position) - middle
    height, aside = away @ up * up, np.cross(up, away)
    flat = away - height
    turns = 2 * math.pi * np.arange(frames) / frames
    places = [middle + height + math.cos(turn) * flat + math.sin(turn) * aside for turn in turns]
    wide, tall = plotter.window_size
    half = max(_half_angle(corners - place, middle - place, up, tall / wide) for place in places)
    plotter.camera.view_angle = 2 * math.degrees(half)
    plotter.camera.focal_point = middle
    for place in places:
        plotter.camera.position = place
        plotter.render()
        yield plotter.screenshot(return_img=True)


def _half_angle(corners: Float[np.ndarray, "c 3"], ahead: Float[np.ndarray, "3"], up: Any, shape: float) -> float:
    """Half the angle, from the lowest to the highest part of a picture, in which the corners are seen."""
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    depth = corners @ ahead
    across, along = np.abs(corners @ right / depth).max(), np.abs(corners @ np.cross(right, ahead) / depth).max()
    return math.atan(max(across * shape, along) / _FILLED)


def save_movie(frames: Sequence[UInt8[np.ndarray, "h w 3"]], path: Path, seconds: float, smaller: int = 1) -> None:
    """Write pictures as a movie, GIF or MP4 by the ending of its name, with so many seconds for each.

    A GIF is so many times smaller.
    """
    if path.suffix == ".mp4":
        program = optional("imageio_ffmpeg", "viz", "a movie in MP4").get_ffmpeg_exe()
        tall, wide, _ = frames[0].shape
        given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{wide}x{tall}", "-r", f"{1 / seconds:g}", "-i", "-"]
        wanted = ["-r", "25", "-c:v", "libx264", "-pix_fmt", "yuv420p", str(path)]
        data = b"".join(frame.tobytes() for frame in frames)
        subprocess.run([program, "-loglevel", "error", "-y", *given, *wanted], input=data, check=True)
        return
    reduced = (Image.fromarray(frame).reduce(smaller) for frame in frames)
    first, *others = (frame.convert("P", palette=Image.Palette.ADAPTIVE) for frame in reduced)
    first.save(path, "GIF", save_all=True, append_images=others, duration=round(1000 * seconds), loop=0)
