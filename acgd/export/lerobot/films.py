"""Images of a dataset as one H.264 film after another."""

from pathlib import Path

import imageio_ffmpeg
import numpy as np

FRAMES_AT_MOST = 200_000
"""Of one film: some 200 MB of small images."""


class Films:
    """Episodes end to end in films; a film is closed when it is full."""

    def __init__(self, path: "callable", size: int, fps: int, crf: int) -> None:
        """path: number of a film -> where it goes. size: pixels a side."""
        self.path, self.size, self.fps, self.crf = path, size, fps, crf
        self.number, self.frames = 0, 0
        self._writer = None

    @property
    def pixel_format(self) -> str:
        """Half the resolution in colour where sizes are even, as most decoders want it."""
        return "yuv420p" if self.size % 2 == 0 else "yuv444p"

    def add(self, images: np.ndarray) -> tuple[int, float, float]:
        """images (T, H, W, 3) uint8 -> number of the film, and from when to when in it, in seconds."""
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
        """Finish the film that is being written."""
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
            # a key frame every other frame, so that any frame is read at once; one thread, so that bytes repeat
            output_params=["-crf", str(self.crf), "-g", "2", "-threads", "1", "-bf", "0"],
        )
        writer.send(None)
        return writer
