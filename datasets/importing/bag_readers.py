"""The value of one signal at each frame: reads each message once, mixes neighbours where asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

from codediffuser.datagen.episode_format import ImageOptions
from codediffuser.datagen.log_step import StoredPicture
from codediffuser.datasets.importing.config import NumberSource
from codediffuser.datasets.importing.decoding import Decoder
from codediffuser.datasets.importing.pictures import color_of, is_raw, picture_bytes
from codediffuser.datasets.importing.recording import Recording
from codediffuser.datasets.importing.sampler import Samples
from codediffuser.datasets.importing.stored_pictures import stored_picture
from codediffuser.datasets.importing.values import joints_of
from codediffuser.datasets.importing.video import VideoReader, video_codec
from codediffuser.errors import DatasetError

V = TypeVar("V")


class SignalReader(Generic[V]):
    """Values of one signal by number of frame.

    Args:
        index: (n,) places in the recording of the signal's messages, by time.
        samples: Which of them each frame takes.
        read: Value of the message at a place in the recording.
        mix: Value between two, for signals that are interpolated.
    """

    def __init__(
        self,
        index: np.ndarray,
        samples: Samples,
        read: Callable[[int], V],
        mix: Callable[[V, V, float], V] | None = None,
    ) -> None:
        self._index = index
        self._samples = samples
        self._read = read
        self._mix = mix
        self._held: dict[int, V] = {}

    def at(self, k: int) -> V:
        """Value at frame k; frames are asked for in ascending order."""
        place = int(self._samples.index[k])
        weight = float(self._samples.weight[k])
        places = (place, place + 1) if weight and self._mix is not None else (place,)
        self._held = {
            p: self._held[p] if p in self._held else self._read(int(self._index[p])) for p in places
        }
        if len(places) == 1 or self._mix is None:
            return self._held[place]
        return self._mix(self._held[place], self._held[place + 1], weight)


def message_reader(
    recording: Recording, topic: str, convert: Callable[[Any, str], V]
) -> Callable[[int], V]:
    """A function that reads, decodes and converts the message at a place in the recording."""
    decoder = Decoder(recording.topics[topic])
    return lambda index: convert(decoder.decode(recording.read(topic, index)), topic)


def color_reader(
    recording: Recording, topic: str, options: ImageOptions
) -> Callable[[int], np.ndarray | StoredPicture]:
    """A function that gives the picture (H, W, 3) of a message: still or part of a video.

    Args:
        recording: Stays open.
        topic: Of pictures.
        options: Pictures that are compressed like this already are not decoded.
    """
    decoder = Decoder(recording.topics[topic])

    def decoded(index: int) -> Any:
        return decoder.decode(recording.read(topic, index))

    video: list[VideoReader] = []

    def read(index: int) -> np.ndarray | StoredPicture:
        if video:
            return video[0].picture(index)
        message = decoded(index)
        codec = video_codec(message)
        if codec is None:
            kept = None if is_raw(message) else stored_picture(picture_bytes(message), options)
            return color_of(message, topic) if kept is None else kept
        video.append(VideoReader(lambda i: picture_bytes(decoded(i)), codec, topic))
        return video[0].picture(index)

    return read


class JointPicker:
    """Takes the configured joints out of messages, in the configured order.

    Args:
        source: The configuration.
        where: Its name, for messages.
    """

    def __init__(self, source: NumberSource, where: str) -> None:
        self._source = source
        self._where = where
        self._order: dict[tuple[str, ...], list[int]] = {}

    def names(self, message: Any, topic: str) -> tuple[str, ...]:
        """Names of what is taken."""
        return self._source.joints or joints_of(message, topic)[0]

    def values(self, message: Any, topic: str) -> np.ndarray:
        """Values (n,) float64, scaled.

        Raises:
            DatasetError: A joint is missing in the message.
        """
        names, values = joints_of(message, topic)
        return values[self._places(names)] * self._source.scale

    def velocities(self, message: Any, topic: str) -> np.ndarray:
        """Velocities (n,) float64; zeros when the message gives none."""
        names, values = joints_of(message, topic)
        given = np.asarray(getattr(message, "velocity", ()), np.float64)
        if given.shape != values.shape:
            given = np.zeros_like(values)
        return given[self._places(names)] * self._source.scale

    def _places(self, names: tuple[str, ...]) -> list[int]:
        if names not in self._order:
            wanted = self._source.joints or names
            missing = [name for name in wanted if name not in names]
            if missing:
                raise DatasetError(
                    f"{self._where}: no joint {', '.join(missing)} in a message; it names "
                    f"{', '.join(names)}"
                )
            self._order[names] = [names.index(name) for name in wanted]
        return self._order[names]
