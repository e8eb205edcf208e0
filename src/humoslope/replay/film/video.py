"""Rendering of a rollout to a video and a contact sheet, without a display, a GPU or a graphics driver."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import imageio_ffmpeg
import numpy as np
from PIL import Image

from humoslope.cpu import usable_cores
from humoslope.errors import UserError
from humoslope.files import write_atomically
from humoslope.interrupts import leave_signals_to_parent
from humoslope.ranges import Checked, NotNegative, Positive, Range
from humoslope.replay.film.frames import Frames
from humoslope.replay.film.raytrace import Picture
from humoslope.replay.meshes import load_meshes
from humoslope.replay.rollout import Rollout

SHEET_COLUMNS, SHEET_ROWS = 3, 2
GAP = 6
"""White space between the pictures of a contact sheet, pixels."""
QUALITY = ["-crf", "20", "-movflags", "+faststart"]
"""Options for x264: hardly visible losses; playback can start before the whole file is loaded."""
ANIMATIONS: dict[str, dict[str, Any]] = {".gif": {}, ".webp": {"quality": 60, "method": 6}}
"""Endings of animated pictures, which web pages show in place, and what Pillow is told for each."""
FASTEST_GIF = 50.0
"""Most pictures per second that browsers show of a GIF; they slow down those that ask for more."""
ENDINGS = (".mp4", *ANIMATIONS)
"""Endings of the files that `write_video` writes."""


@dataclass(frozen=True)
class VideoCfg(Checked):
    """Time span, size and speed of a video.

    Attributes:
        start: Start of the video in the rollout, s.
        seconds: Length of the video, s; by default to the end of the rollout.
        fps: Pictures per second.
        width: Width of the pictures, pixels; even, as video codecs require.
        height: Height of the pictures, pixels; even, as video codecs require.
        workers: Number of drawing processes; 0 for one on each core.
        meshes: Draw the robot with the meshes that `humoslope meshes` has fetched.
    """

    VERB: ClassVar[str] = "video"

    start: NotNegative = 0.0
    seconds: Positive | None = None
    fps: Annotated[float, Range(1.0, 120.0)] = 25.0
    width: Annotated[int, Range(64, 4096)] = 960
    height: Annotated[int, Range(64, 4096)] = 540
    workers: Annotated[int, Range(0, 1024)] = 0
    meshes: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width", "height"):
            if getattr(self, name) % 2:
                raise UserError(f"video: {name} is {getattr(self, name)}; it must be even.")

    def steps(self, rollout: Rollout) -> list[int]:
        """Returns the steps of the rollout that are drawn.

        Raises:
            UserError: If the rollout ends before the start.
        """
        time = rollout.columns.time
        last = float(time[-1]) if self.seconds is None else min(float(time[-1]), self.start + self.seconds)
        if self.start >= last:
            raise UserError(f"video: start is {self.start:g} s, but the rollout ends at {time[-1]:g} s.")
        # The first step is the first that was recorded. Times in single precision lie on either side of what they mean.
        moments = np.arange(max(self.start, float(time[0])), last, 1.0 / self.fps)
        rounding = 0.01 * rollout.header["dt"]
        return np.searchsorted(time, moments - rounding, side="left").clip(max=len(time) - 1).tolist()


def write_video(rollout: Rollout, path: Path, cfg: VideoCfg, on_frame: Callable[[], None] = lambda: None) -> None:
    """Writes an mp4, or an animated picture.

    Args:
        rollout: The rollout.
        path: The file; its ending, one of `ENDINGS`, decides its format.
        cfg: Time span, size and speed.
        on_frame: Called after every picture.

    Raises:
        UserError: If ffmpeg cannot be run, or a GIF cannot have so many pictures per second.
    """
    if path.suffix == ".gif" and ((100.0 / cfg.fps) % 1.0 or cfg.fps > FASTEST_GIF):
        raise UserError(
            f"video: fps is {cfg.fps:g}; a GIF shows each picture for whole hundredths of a second, at least two: give "
            "50, 25, 20, 12.5 or 10, or write .mp4 or .webp."
        )
    steps = cfg.steps(rollout)
    with contextlib.closing(_draw(rollout, steps, cfg)) as pictures:
        encode = _animate if path.suffix in ANIMATIONS else _encode
        write_atomically(path, lambda temporary: encode(pictures, temporary, cfg, on_frame))


def write_sheet(rollout: Rollout, path: Path, cfg: VideoCfg) -> None:
    """Writes a PNG of pictures spread evenly over the time span."""
    steps = cfg.steps(rollout)
    count = SHEET_COLUMNS * SHEET_ROWS
    # Each picture represents an equal part of the time span, and shows its middle.
    chosen = [steps[int((i + 0.5) * len(steps) / count)] for i in range(count)]
    sheet = contact_sheet(list(_draw(rollout, chosen, cfg)))
    write_atomically(path, lambda temporary: Image.fromarray(sheet).save(temporary, format="PNG", optimize=True))


def contact_sheet(pictures: Sequence[Picture]) -> Picture:
    """Returns `SHEET_COLUMNS` x `SHEET_ROWS` pictures of one size, arranged row by row."""
    height, width, _ = pictures[0].shape
    size = (SHEET_ROWS * (height + GAP) - GAP, SHEET_COLUMNS * (width + GAP) - GAP, 3)
    sheet = np.full(size, 255, np.uint8)
    for i, picture in enumerate(pictures):
        y, x = (i // SHEET_COLUMNS) * (height + GAP), (i % SHEET_COLUMNS) * (width + GAP)
        sheet[y : y + height, x : x + width] = picture
    return sheet


def _encode(pictures: Iterable[Picture], path: Path, cfg: VideoCfg, on_frame: Callable[[], None]) -> None:
    try:
        writer = imageio_ffmpeg.write_frames(
            str(path),
            (cfg.width, cfg.height),
            fps=cfg.fps,
            codec="libx264",
            quality=None,  # see QUALITY
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=QUALITY,
        )
        with contextlib.closing(writer):
            writer.send(None)
            for picture in pictures:
                writer.send(np.ascontiguousarray(picture))
                on_frame()
    except (RuntimeError, OSError) as error:
        reason = str(error).strip().splitlines()[0].rstrip(".") if str(error).strip() else type(error).__name__
        raise UserError(f"ffmpeg could not write the video ({reason}).") from None


def _animate(pictures: Iterable[Picture], path: Path, cfg: VideoCfg, on_frame: Callable[[], None]) -> None:
    def drawn() -> Iterator[Image.Image]:
        for picture in pictures:
            yield Image.fromarray(picture)
            on_frame()

    frames = drawn()
    next(frames).save(
        path,
        format=path.suffix[1:],
        save_all=True,
        append_images=frames,
        duration=round(1000.0 / cfg.fps),
        loop=0,
        **ANIMATIONS[path.suffix],
    )


_task: tuple[Rollout, VideoCfg] | None = None
_frames: Frames | None = None
"""What a drawing process draws, and with what; set once in each process."""


def _draw(rollout: Rollout, steps: Sequence[int], cfg: VideoCfg) -> Generator[Picture]:
    """Yields the pictures of these steps, in their order."""
    workers = min(cfg.workers or usable_cores(), len(steps))
    if workers == 1:
        yield from map(_frames_of(rollout, cfg), steps)
        return
    # Spawned, not forked: a fork would copy locks that other threads hold.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _prepare, (rollout, cfg))
    try:
        yield from pool.map(_draw_one, steps)
    except BrokenProcessPool:
        raise UserError(
            f"video: one of {workers} drawing processes was ended from outside, perhaps for want of memory; try fewer "
            "with --workers."
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)  # a video that is given up is not drawn to its end


def _frames_of(rollout: Rollout, cfg: VideoCfg) -> Frames:
    meshes = load_meshes(rollout.header["robot"]["name"]) if cfg.meshes else None
    return Frames(rollout, cfg.width, cfg.height, meshes)


def _prepare(rollout: Rollout, cfg: VideoCfg) -> None:
    """Prepares a drawing process."""
    global _task  # noqa: PLW0603 - a process pool has no other place for what its processes keep
    _task = rollout, cfg
    leave_signals_to_parent()


def _draw_one(step: int) -> Picture:
    global _frames  # noqa: PLW0603
    assert _task is not None
    # Here and not in `_prepare`, whose errors would reach the user as a broken process pool.
    _frames = _frames or _frames_of(*_task)
    return _frames(step)
