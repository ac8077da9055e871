"""A file of HDF5 that its process did not close, as HDF5 reads closed ones.

HDF5 marks a file that is open for writing, and afterwards opens it only in SWMR mode, in which it reads a damaged spot again and again for
hours. Here the mark is removed from the data that HDF5 reads, not from the file: the flags of the superblock (version 3: byte 11) are
cleared, its end of file (bytes 28 to 35) is set to the size of the file, and its checksum (bytes 44 to 47) is recomputed. Source: HDF5 File
Format Specification 3.0; checksum: Bob Jenkins, lookup3.
"""

import io
import os
import struct

START, LENGTH = b"\x89HDF\r\n\x1a\n\3\x08", 48  # of a superblock of version 3
MASK = 0xFFFFFFFF


class Source(io.RawIOBase):
    """A readable file object that owns a descriptor and has a position of its own, also after a fork."""

    def __init__(self, descriptor):
        """Take the descriptor of an open file; a set mark is cleared in `_head`, the bytes that stand for the superblock."""
        self._descriptor = descriptor
        self._at = 0  # the present place
        self.size = os.fstat(descriptor).st_size
        self._head = b""  # stands for the first bytes of the file
        head = self._part(LENGTH)
        marked = head[:10] == START and len(head) == LENGTH and head[11] != 0
        body = head[:11] + b"\0" + head[12:28] + struct.pack("<Q", self.size) + head[36:44]
        self._head = body + struct.pack("<I", checksum(body)) if marked else head

    def __del__(self):
        """Close the descriptor of the file."""
        os.close(self._descriptor)

    def seek(self, offset, whence=0):
        """Move the present place by `offset` from the start (whence 0), itself (1) or the end (2); return it, in bytes."""
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self):
        """The present place, in bytes from the begin."""
        return self._at

    def readinto(self, buffer):
        """Read bytes into a buffer, with the superblock repaired; returns their number."""
        view = memoryview(buffer).cast("B")
        data = self._part(len(view))
        view[: len(data)] = data
        self._at += len(data)
        return len(data)

    def _part(self, size):
        """Up to `size` bytes from the present place, with the superblock repaired."""
        if hasattr(os, "pread"):
            data = os.pread(self._descriptor, size, self._at)
        else:
            os.lseek(self._descriptor, self._at, os.SEEK_SET)
            data = os.read(self._descriptor, size)
        return self._head[self._at : self._at + len(data)] + data[max(0, len(self._head) - self._at) :]


def checksum(data):
    """lookup3 of the 44 bytes before a superblock's checksum."""
    words = [*struct.unpack("<11I", data), 0]
    a = b = c = 0xDEADBEEF + len(data)
    for k in (0, 3, 6):
        a, b, c = a + words[k], b + words[k + 1], c + words[k + 2]
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = b, b + c & MASK, (a - c & MASK) ^ _turned(c, shift)
    x, y, z = c, b + words[10] & MASK, a + words[9] & MASK
    for shift in (14, 11, 25, 16, 4, 14, 24):
        x, y, z = z, (x ^ y) - _turned(y, shift) & MASK, y
    return y


def _turned(x, shift):
    """The 32 bits of x turned left by `shift`."""
    x &= MASK
    return (x << shift | x >> 32 - shift) & MASK
