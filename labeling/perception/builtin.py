"""The `builtin` backend: a small network of ours, trained on our own renders; its weights ship.

Beside features it tells for each pixel where the middle of its instance lies, which parts things
that touch: cells of a crate, books in a row. It sees colour, heights and normals, so it needs
depth and calibrated cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import SetupError, ShapeError
from codediffuser.files import atomic_path, sha256_file
from codediffuser.labeling.perception.features import FEATURES, FeatureOptions
from codediffuser.labeling.perception.references import ReferenceLibrary, make_reference
from codediffuser.schema import Document

if TYPE_CHECKING:
    import torch

WEIGHTS = Path(__file__).parent / "weights" / "builtin.safetensors"
CARD_SUFFIX = ".yaml"
FOCAL_PX = 248.4
"""Focal length of the pictures that it was trained on; others are resized to about this."""
NO_PICTURE = np.zeros((0, 0, 3), dtype=np.uint8)
"""Trained references come from no single picture."""
MULTIPLE = 16
"""The network takes pictures whose sides divide by this."""


class Card(Document):
    """What the weights are and how they were made (`schema: codediffuser.weights/1`)."""

    KIND: ClassVar[str] = "weights"
    VERSION: ClassVar[int] = 1

    categories: tuple[str, ...]
    """In the order of the reference vectors, the background first."""
    min_cosine: float
    """A pixel whose nearest reference is less near than this shows none of the categories."""
    sha256: str
    """Of the weights."""
    command: str
    """What trained them."""
    recipe: dict[str, float | int]
    scenes: dict[str, int]
    """Scenes of each task that were trained on, and `held_out` for the scores below."""
    made_at: str
    """When, ISO 8601, UTC."""
    minutes: float
    """Of training, on one core."""
    scores: dict[str, dict[str, float]]
    """By category, on held-out scenes with domain randomisation; see `builtin_training.score`."""


@dataclass(frozen=True, slots=True)
class Perceived:
    """What the network says of some views, at the resolution that it works at."""

    maps: np.ndarray
    """(V, h, w, D) float32 unit features."""
    middles_world: np.ndarray
    """(V, h, w, 3) float32, metres: where the middle of the pixel's instance is; without meaning
    where there is no reading and in the background."""


class BuiltinFeatures:
    """See the module.

    Args:
        weights: File of weights, its card beside it; None takes those that ship.

    Raises:
        SetupError: The file or its card is missing, or they do not belong together.
    """

    name = "builtin"

    def __init__(self, weights: Path | None = None) -> None:
        path = weights or WEIGHTS
        self.card = _card(path)
        self._network = load_network(path)

    @property
    def dimensions(self) -> int:
        """D, the length of an embedding."""
        return int(self._network.references.shape[1])

    def library(self) -> ReferenceLibrary:
        """The references that were trained with the network: one feature for each category."""
        import torch

        unit = torch.nn.functional.normalize(self._network.references.detach(), dim=1).numpy()
        return ReferenceLibrary(
            backend=self.name,
            dimensions=self.dimensions,
            threshold=self.card.min_cosine,
            calibrated=True,
            references=tuple(
                make_reference(
                    feature, NO_PICTURE, category, episode="", frame=0, camera="", pixel=(0, 0),
                    by="train_builtin", at=self.card.made_at,
                )
                for feature, category in zip(unit, self.card.categories, strict=True)
            ),
        )  # fmt: skip

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        """Unit features; see `FeatureBackend.maps`.

        Raises:
            ShapeError: Depth or cameras are missing.
        """
        return self.perceive(images, depth_m, cameras).maps

    def perceive(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None,
        cameras: Sequence[Camera] | None,
    ) -> Perceived:
        """Features and middles of instances; arguments as for `maps`."""
        import torch

        from codediffuser.labeling.perception.builtin_network import cues
        from codediffuser.labeling.perception.builtin_targets import voted_points

        if depth_m is None or cameras is None or not len(images) == len(depth_m) == len(cameras):
            raise ShapeError(
                "the builtin backend needs a depth picture and a calibrated camera for each of "
                f"{len(images)} pictures"
            )
        maps, middles = [], []
        for image, depth, camera in zip(images, depth_m, cameras, strict=True):
            image, depth, K = _resized(image, depth, camera)
            T = camera.T_world_camera.astype(np.float32)
            with torch.inference_mode():
                inputs = cues(*(torch.from_numpy(a)[None] for a in (image, depth, K, T)))
                height, width = depth.shape
                pad = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
                embedding, votes = self._network(torch.nn.functional.pad(inputs, pad))
            maps.append(_channels_last(embedding)[:height, :width])
            votes = _channels_last(votes)[:height, :width]
            middles.append(voted_points(votes, depth, K, camera.T_world_camera))
        return Perceived(np.stack(maps), np.stack(middles))


def save_weights(network: torch.nn.Module, path: Path) -> str:
    """Write a network's weights, halved to 16 bits, and return the file's SHA-256."""
    from safetensors.torch import save_file

    state = {
        name: (value.half() if value.is_floating_point() else value).contiguous()
        for name, value in network.state_dict().items()
    }
    with atomic_path(path) as partial:
        save_file(state, str(partial))
    return sha256_file(path)


def card_path(weights: Path) -> Path:
    """Where the card of a file of weights lies."""
    return weights.with_suffix(CARD_SUFFIX)


def _card(path: Path) -> Card:
    for needed in (path, card_path(path)):
        if not needed.is_file():
            raise SetupError(
                f"no weights of the builtin network at {needed}; the package ships them: install "
                "it again, or train some with `python -m "
                "codediffuser.labeling.perception.train_builtin --out FILE.safetensors`"
            )
    card = Card.load(card_path(path))
    if sha256_file(path) != card.sha256:
        raise SetupError(
            f"{path} is not the file that {card_path(path).name} describes (SHA-256 differs); "
            "restore both from the package"
        )
    return card


def load_network(path: Path) -> Any:
    """The network with the weights of a file, ready to be used."""
    from safetensors.torch import load_file

    from codediffuser.labeling.perception.builtin_network import BuiltinNetwork

    state = load_file(str(path))
    network = BuiltinNetwork(len(state["references"]))
    network.load_state_dict(state)
    return network.eval()


def _resized(
    image: np.ndarray, depth_m: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture, depth and intrinsics (float32) at about the focal length of training."""
    import cv2

    scale = FOCAL_PX / camera.K[1, 1]
    depth_m = np.nan_to_num(depth_m.astype(np.float32))
    if not 0.8 < scale < 1.25:
        size = (round(camera.width * scale), round(camera.height * scale))
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        image = cv2.resize(image, size, interpolation=how)
        # Depth must not be mixed across edges.
        depth_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST)
    K = camera.K.copy()
    for axis, (new, old) in enumerate(
        ((image.shape[1], camera.width), (image.shape[0], camera.height))
    ):
        K[axis, :2] *= new / old
        K[axis, 2] = (K[axis, 2] + 0.5) * new / old - 0.5
    return np.ascontiguousarray(image), depth_m, K.astype(np.float32)


def _channels_last(batch: Any) -> np.ndarray:
    """(1, C, H, W) tensor to (H, W, C) array."""
    return np.ascontiguousarray(batch[0].permute(1, 2, 0).numpy())


@FEATURES.add("builtin")
def _from_options(options: FeatureOptions) -> BuiltinFeatures:
    return BuiltinFeatures(options.weights)
