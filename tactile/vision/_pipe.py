"""Images that come one after another through a pipe: PGM, PPM, PNG, JPEG or NPY, told apart by their first bytes.

``ffmpeg -f v4l2 -i /dev/video0 -f image2pipe -c:v pgm - | loadid tactile live --camera - ...`` makes the first of them.
"""

from __future__ import annotations

import io
from typing import Any, BinaryIO

import numpy as np

from structures.errors import InputError

from .._arrays import UnusableFrame

LARGEST, PIECE = 64 << 20, 1 << 16  # bytes of one image, at most; and of a read
RESTARTS = (0, *range(0xD0, 0xD8))  # behind a byte 255 that is data of a scan, and no marker
PNG, JPEG, NPY = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"\x93NUMPY"


class Pipe:
    """Images (H, W) or (H, W, 3) of a stream of bytes: an iterator, that an image which cannot be read does not end.

    Parameters
    ----------
    stream : binary file
    name : str
        In errors.
    """

    def __init__(self, stream: BinaryIO, name: str = "standard input") -> None:
        self._stream, self._name, self._read, self._held = stream, name, 0, bytearray()

    def __iter__(self) -> Pipe:
        return self

    def __next__(self) -> Any:
        if not self._hold(2):
            raise StopIteration
        head = self._exactly(2)
        self._read += 1
        if head in (b"P5", b"P6"):
            return self._raster(3 if head == b"P6" else 1)
        if head == PNG[:2]:
            return self._decoded(head + self._png())
        if head == JPEG:
            return self._decoded(head + self._jpeg())
        if head == NPY[:2]:
            return self._array(head)
        raise InputError("no images in the pipe", where=self._where, found=repr(head),
                         expected="PGM, PPM, PNG, JPEG or NPY, one after another",
                         hint="ffmpeg -i SOURCE -f image2pipe -c:v pgm -")  # fmt: skip

    @property
    def _where(self) -> str:
        return f"{self._name}: frame {self._read}"

    def _hold(self, count: int) -> bool:
        """Whether so many bytes are there, once they have come."""
        while len(self._held) < count:
            more = (
                self._stream.read1(PIECE) if isinstance(self._stream, io.BufferedIOBase) else self._stream.read(PIECE)
            )
            if not more:
                return False
            self._held += more
        return True

    def _exactly(self, count: int) -> bytes:
        if not 0 <= count <= LARGEST:
            raise InputError("an image of a size that none has", where=self._where, found=f"{count} bytes",
                             expected=f"at most {LARGEST}")  # fmt: skip
        if not self._hold(count):
            found = len(self._held)
            self._held.clear()
            raise UnusableFrame("the pipe ends within an image", where=self._where, found=f"{found} bytes",
                                expected=f"{count}")  # fmt: skip
        found_bytes = bytes(self._held[:count])
        del self._held[:count]
        return found_bytes

    def _raster(self, colours: int) -> Any:
        """PGM or PPM of 8 or 16 bits (netpbm): width, height, largest value, one blank, rows."""
        width, height, most = (self._number() for _ in range(3))
        kind = np.dtype(np.uint8 if most < 256 else ">u2")
        data = np.frombuffer(self._exactly(width * height * colours * kind.itemsize), kind)
        image = data.reshape((height, width) if colours == 1 else (height, width, colours))
        return image if kind.itemsize == 1 else image.astype(np.uint16)

    def _number(self) -> int:
        """A number of a head, and the one blank behind it; comments are passed over."""
        digits = b""
        while True:
            one = self._exactly(1)
            if one == b"#":
                while self._exactly(1) != b"\n":
                    pass
            elif one.isdigit() and len(digits) < 9:
                digits += one
            elif one.isspace() and digits:
                return int(digits)
            elif not one.isspace():
                raise InputError("a damaged image in the pipe", where=self._where, found=repr(one),
                                 expected="the head of a PGM or PPM image")  # fmt: skip

    def _png(self) -> bytes:
        """Chunks up to the last one."""
        parts = [self._exactly(len(PNG) - 2)]
        while True:
            head = self._exactly(8)
            parts += [head, self._exactly(int.from_bytes(head[:4], "big") + 4)]
            if head[4:] == b"IEND":
                return b"".join(parts)

    def _jpeg(self) -> bytes:
        """Segments up to the end of the image."""
        parts = []
        while True:
            marker = self._exactly(2)
            parts.append(marker)
            if marker == b"\xff\xd9":
                return b"".join(parts)
            length = self._exactly(2)
            parts += [length, self._exactly(int.from_bytes(length, "big") - 2)]
            if marker == b"\xff\xda":
                parts.append(self._scan())

    def _scan(self) -> bytes:
        """Data of a scan up to the marker that ends it, which stays."""
        at = 0
        while at < LARGEST and self._hold(at + 2):
            at = self._held.find(b"\xff", at)
            if at < 0:
                at = len(self._held)
            elif not self._hold(at + 2):
                break
            elif self._held[at + 1] in RESTARTS:
                at += 2
            else:
                return self._exactly(at)
        return self._exactly(len(self._held) + 1)  # refused: there are no more

    def _array(self, head: bytes) -> Any:
        version = self._exactly(len(NPY) - 2 + 2)
        wide = 2 if version[-2] == 1 else 4
        length = self._exactly(wide)
        words = self._exactly(int.from_bytes(length, "little"))
        start = io.BytesIO(head + version + length + words)
        np.lib.format.read_magic(start)
        read = np.lib.format.read_array_header_1_0 if wide == 2 else np.lib.format.read_array_header_2_0
        shape, turned, kind = read(start)
        if kind.hasobject:
            raise InputError("no image", where=self._where, found=str(kind), expected="numbers")
        data = np.frombuffer(self._exactly(int(np.prod(shape)) * kind.itemsize), kind)
        return data.reshape(shape, order="F" if turned else "C")

    def _decoded(self, data: bytes) -> Any:
        from PIL import Image

        try:
            with Image.open(io.BytesIO(data)) as image:
                return np.asarray(image if image.mode in ("L", "RGB", "RGBA") else image.convert("RGB"))
        except Exception as error:  # a damaged image may raise anything in a decoder
            raise UnusableFrame("the image cannot be read", where=self._where, found=str(error)[:200]) from None
