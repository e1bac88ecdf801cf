"""Pictures out of a stream of H.264 or H.265 packets, one message each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from codediffuser.errors import DatasetError

_CODECS = {"h264": "h264", "avc": "h264", "h265": "hevc", "hevc": "hevc"}


def video_codec(message: Any) -> str | None:
    """Name of the decoder of a video message; None for still pictures."""
    words = str(getattr(message, "format", "")).lower().replace(";", " ").split()
    return next((_CODECS[word] for word in words if word in _CODECS), None)


class VideoReader:
    """Decodes the packets of one topic, forwards; a jump starts at the key frame before it.

    Args:
        packets: Payload of the message at a place.
        codec: `h264` or `hevc`, as `video_codec` gives it.
        topic: For messages.

    Encoders of robots send no B-frames (Foxglove's schema forbids them), so each packet gives one
    picture at once.
    """

    def __init__(self, packets: Callable[[int], bytes], codec: str, topic: str) -> None:
        self._packets = packets
        self._codec = codec
        self._topic = topic
        self._decoder: Any = None
        self._next = 0
        self._picture: np.ndarray | None = None

    def picture(self, index: int) -> np.ndarray:
        """Colour (H, W, 3) uint8 RGB after the packet at `index`.

        Raises:
            DatasetError: No key frame comes before it, or the stream is damaged.
        """
        if self._decoder is None or index < self._next - 1:
            self._open(self._key_before(index))
        for i in range(self._next, index + 1):
            self._feed(self._packets(i))
        self._next = index + 1
        if self._picture is None:
            raise DatasetError(f"topic '{self._topic}': no picture comes out of the video")
        return self._picture

    def _key_before(self, index: int) -> int:
        for i in range(index, -1, -1):
            if is_key_packet(self._packets(i), self._codec):
                return i
        raise DatasetError(
            f"topic '{self._topic}': no key frame comes before packet {index} of the video"
        )

    def _open(self, start: int) -> None:
        import av

        self._decoder = av.CodecContext.create(self._codec, "r")
        # Frame threads would hold pictures back.
        self._decoder.thread_type = "SLICE"
        self._decoder.flags |= av.codec.context.Flags.low_delay
        self._next, self._picture = start, None

    def _feed(self, data: bytes) -> None:
        import av

        try:
            for frame in self._decoder.decode(av.Packet(data)):
                self._picture = np.asarray(frame.to_ndarray(format="rgb24"))
        except av.error.FFmpegError as error:
            raise DatasetError(f"topic '{self._topic}': the video is damaged ({error})") from None


def is_key_packet(data: bytes, codec: str) -> bool:
    """Whether decoding can start at a packet (Annex B): it holds an IDR picture."""
    position = data.find(b"\x00\x00\x01")
    while 0 <= position < len(data) - 3:
        unit = data[position + 3]
        kind = unit & 0x1F if codec == "h264" else (unit >> 1) & 0x3F
        if (kind == 5) if codec == "h264" else (16 <= kind <= 21):
            return True
        position = data.find(b"\x00\x00\x01", position + 3)
    return False
