"""Moving pictures small enough to live inside a notebook or a README."""

from __future__ import annotations

import base64
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.files import replacing


def _checked(frames: Any, fps: float) -> np.ndarray:
    pictures = np.asarray(frames)
    if pictures.ndim != 4 or pictures.shape[-1] != 3 or len(pictures) == 0:
        raise ShapeError(f"frames have shape {pictures.shape}: expected (n, height, width, 3)")
    if pictures.dtype != np.uint8:
        raise ShapeError(f"frames are {pictures.dtype}: expected uint8, 0 to 255")
    if not fps > 0:
        raise ParameterError(f"fps is {fps}: expected a positive number of frames per second")
    return pictures


def write_mp4(frames: Any, path: Path, fps: float, quality: int = 28) -> Path:
    """Write frames as H.264 that every browser plays.

    Args:
        frames: uint8 ``(n, height, width, 3)``; odd sizes lose their last row or column.
        path: The file, ending in ``.mp4``.
        fps: Frames per second.
        quality: Constant rate factor: 18 is large and sharp, 35 small and soft.

    Raises:
        ShapeError: If the frames have another shape or type.
        ParameterError: If ``fps`` is not positive.
        ImportError: If no encoder is installed.
    """
    import imageio_ffmpeg

    pictures = _checked(frames, fps)
    height, width = (size - size % 2 for size in pictures.shape[1:3])
    options = ["-crf", str(quality), "-preset", "slow", "-movflags", "+faststart"]
    with replacing(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary), (width, height), fps=fps, codec="libx264", quality=None,
            pix_fmt_out="yuv420p", macro_block_size=2, output_params=options,
        )  # fmt: skip
        writer.send(None)
        for picture in pictures[:, :height, :width]:
            writer.send(np.ascontiguousarray(picture))
        writer.close()
    return path


def gif_bytes(frames: Any, fps: float, width: int = 320, colours: int = 64) -> bytes:
    """Encode frames as an endless GIF.

    Args:
        frames: uint8 ``(n, height, width, 3)``.
        fps: Frames per second; GIF counts in hundredths of a second, so it is rounded.
        width: Pixels; larger frames are scaled down, smaller ones stay.
        colours: Size of the palette, at most 256.

    Raises:
        ShapeError: If the frames have another shape or type.
        ParameterError: If ``fps`` is not positive.
    """
    pictures = _checked(frames, fps)
    scale = min(1.0, width / pictures.shape[2])
    size = (round(pictures.shape[2] * scale), round(pictures.shape[1] * scale))
    images = [Image.fromarray(p).resize(size, Image.Resampling.LANCZOS) for p in pictures]
    # One palette for all frames: otherwise still parts flicker.
    palette = images[len(images) // 2].quantize(colours)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = io.BytesIO()
    images[0].save(
        buffer, "GIF", save_all=True, append_images=images[1:], loop=0, optimize=True,
        duration=max(20, 10 * round(100 / fps)),
    )  # fmt: skip
    return buffer.getvalue()


def write_gif(frames: Any, path: Path, fps: float, width: int = 320, colours: int = 64) -> Path:
    """Write frames as an endless GIF file; see :func:`gif_bytes`."""
    content = gif_bytes(frames, fps, width, colours)
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


def show_video(frames: Any, fps: float, width: int = 400) -> Any:
    """Embed a video in a notebook: MP4, or GIF where no encoder is installed.

    Args:
        frames: uint8 ``(n, height, width, 3)``.
        fps: Frames per second.
        width: Shown width in pixels.

    Returns:
        An ``IPython.display.HTML`` object.

    Raises:
        ShapeError: If the frames have another shape or type.
        ParameterError: If ``fps`` is not positive.
    """
    from IPython.display import HTML

    try:
        with tempfile.TemporaryDirectory() as folder:
            content = write_mp4(frames, Path(folder) / "video.mp4", fps).read_bytes()
    except (ImportError, OSError):
        text = base64.b64encode(gif_bytes(frames, fps, width)).decode()
        return HTML(f'<img width="{width}" alt="video" src="data:image/gif;base64,{text}">')
    text = base64.b64encode(content).decode()
    source = f"data:video/mp4;base64,{text}"
    return HTML(f'<video width="{width}" controls loop muted autoplay src="{source}"></video>')
