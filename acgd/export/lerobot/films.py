"""Writes the images of a dataset as H.264 films."""

from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np

FRAMES_AT_MOST = 200_000
"""Most frames of one film: some 200 MB of small images."""


class Films:
    """Films that hold episodes one after another. A full film is closed, and the next one begins."""

    def __init__(self, path: Callable[[int], Path], size: int, fps: int, crf: int) -> None:
        """path: number of a film -> its file. size: height and width, pixels."""
        self.path, self.size, self.fps, self.crf = path, size, fps, crf
        self.number, self.frames = 0, 0
        self._writer = None

    @property
    def pixel_format(self) -> str:
        """Half the resolution in colour where the size is even, which most decoders need."""
        return "yuv420p" if self.size % 2 == 0 else "yuv444p"

    def add(self, images: np.ndarray) -> tuple[int, float, float]:
        """Adds images (T, H, W, 3) uint8. Returns the number of the film, and first and last time in it, s."""
        if self.frames and self.frames + len(images) > FRAMES_AT_MOST:
            self.close()
            self.number, self.frames = self.number + 1, 0
        if self._writer is None:
            self._writer = self._open(self.path(self.number))
        for image in images:
            self._writer.send(np.ascontiguousarray(image))
        start, self.frames = self.frames, self.frames + len(images)
        return self.number, start / self.fps, self.frames / self.fps

    def close(self) -> None:
        """Closes the current film."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _open(self, path: Path):
        path.parent.mkdir(parents=True, exist_ok=True)
        writer = imageio_ffmpeg.write_frames(
            str(path),
            (self.size, self.size),
            fps=self.fps,
            codec="libx264",
            pix_fmt_out=self.pixel_format,
            macro_block_size=1,
            quality=None,
            # A key frame every other frame makes random access fast. One thread makes the bytes reproducible.
            output_params=["-crf", str(self.crf), "-g", "2", "-threads", "1", "-bf", "0"],
        )
        writer.send(None)
        return writer
