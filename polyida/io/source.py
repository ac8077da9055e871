"""An HDF5 file read through its descriptor: by whatever name it goes, and as if its writer had closed it.

HDF5 marks a file that is open for writing and opens it afterwards only in SWMR mode, in which it reads a damaged spot
again and again for hours. Here the mark is taken off in what is read, not in the file: the flags of the superblock
(version 3: byte 11) are cleared, its end of file (bytes 28 to 35) is that of the file at hand, and its checksum
(bytes 44 to 47) made to fit. Source: HDF5 File Format Specification 3.0; checksum: Bob Jenkins, lookup3.
"""

import os
import struct

SIGNATURE = b"\x89HDF\r\n\x1a\n"
LENGTH = 48  # of the superblock


class Source:
    """A readable file object on a descriptor, which it owns; position and reads are its own, also after a fork."""

    def __init__(self, descriptor):
        self._descriptor, self._at, self.size = descriptor, 0, os.fstat(descriptor).st_size
        head = _read_at(descriptor, LENGTH, 0)
        self.marked = head[:8] == SIGNATURE and len(head) == LENGTH and head[8:10] == b"\3\x08" and head[11] != 0
        self._head = _unmarked(head, self.size) if self.marked else head

    def __del__(self):
        os.close(self._descriptor)

    def seek(self, offset, whence=0):
        """As of a file."""
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self):
        """As of a file."""
        return self._at

    def read(self, size=-1):
        """As of a file, the superblock repaired."""
        begin = self._at
        data = _read_at(self._descriptor, self.size - begin if size < 0 else size, begin)
        self._at += len(data)
        return data if begin >= LENGTH else self._head[begin : begin + len(data)] + data[LENGTH - begin :]

    def readinto(self, buffer):
        """As of a file, the superblock repaired."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)


def _read_at(descriptor, size, begin):
    if hasattr(os, "pread"):
        return os.pread(descriptor, size, begin)
    os.lseek(descriptor, begin, os.SEEK_SET)
    return os.read(descriptor, size)


def _unmarked(head, size):
    body = head[:11] + b"\0" + head[12:28] + struct.pack("<Q", size) + head[36:44]
    return body + struct.pack("<I", checksum(body))


def checksum(data):
    """lookup3 of bytes whose number is a multiple of four, not of twelve."""
    words = list(struct.unpack(f"<{len(data) // 4}I", data))
    a = b = c = (0xDEADBEEF + len(data)) & 0xFFFFFFFF
    while len(words) > 3:
        a, b, c = _mixed(a + words[0], b + words[1], c + words[2])
        words = words[3:]
    a, b, c = (x + y & 0xFFFFFFFF for x, y in zip((a, b, c), words + [0, 0]))
    for shift_c, shift_a, shift_b in ((14, 11, 25), (16, 4, 14), (24, None, None)):
        c = _less(c ^ b, b, shift_c)
        if shift_a:
            a = _less(a ^ c, c, shift_a)
            b = _less(b ^ a, a, shift_b)
    return c


def _mixed(a, b, c):
    for shift in (4, 6, 8, 16, 19, 4):
        a = (a - c & 0xFFFFFFFF) ^ _turned(c, shift)
        c = c + b & 0xFFFFFFFF
        a, b, c = b, c, a
    return a, b, c


def _less(x, y, shift):
    return x - _turned(y, shift) & 0xFFFFFFFF


def _turned(x, shift):
    x &= 0xFFFFFFFF
    return (x << shift | x >> 32 - shift) & 0xFFFFFFFF
