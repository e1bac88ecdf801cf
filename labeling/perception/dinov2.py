"""The `dinov2` backend: patch tokens of a DINOv2 vision transformer (ViT-S, B or L), through timm.

The shape of the network is read off the weights, so one file is all it takes: Meta's `.pth`, or
timm's `model.safetensors`, with or without registers. Nothing is downloaded.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from codediffuser.datagen.episode_format import Camera
from codediffuser.errors import SetupError, ShapeError
from codediffuser.files import cache_folder, sha256_file
from codediffuser.labeling.perception.feature_cache import CachedFeatures
from codediffuser.labeling.perception.features import FEATURES, FeatureBackend, FeatureOptions

if TYPE_CHECKING:
    import torch

MEAN_RGB = (0.485, 0.456, 0.406)
STD_RGB = (0.229, 0.224, 0.225)
"""Of ImageNet, which DINOv2 was trained with; red first."""

CELL_PX = 10
"""Pixels of a picture that one patch covers; the picture is enlarged to fit, so that small things
are seen by more than one patch."""

HEAD_WIDTH = 64
"""Channels of an attention head, in every DINOv2."""

WIDTH_NAMES = {384: "vits14", 768: "vitb14", 1024: "vitl14"}

FILES = {
    "vits14": ("dinov2_vits14_pretrain.pth", "timm/vit_small_patch14_dinov2.lvd142m"),
    "vitb14": ("dinov2_vitb14_pretrain.pth", "timm/vit_base_patch14_dinov2.lvd142m"),
    "vitl14": ("dinov2_vitl14_pretrain.pth", "timm/vit_large_patch14_dinov2.lvd142m"),
}
"""Meta's file name and timm's repository of each variant, smallest first."""


class DinoV2:
    """Normalised patch tokens of the last block.

    Args:
        weights: File of weights.
        device: Where torch computes.
        cell_px: Pixels of a picture that one patch covers.

    Raises:
        SetupError: timm is missing, or the file is not of a DINOv2 that this code knows.
    """

    def __init__(self, weights: Path, *, device: str = "cpu", cell_px: int = CELL_PX) -> None:
        self.weights = weights
        self.device = device
        self.cell_px = cell_px
        self._model = _load(weights, device, _stamp(weights))

    @property
    def name(self) -> str:
        """`dinov2-` and the variant; registers make another one."""
        variant = WIDTH_NAMES.get(self.dimensions, f"width{self.dimensions}")
        registers = self._model.num_reg_tokens
        return f"dinov2-{variant}" + (f"-reg{registers}" if registers else "")

    @property
    def dimensions(self) -> int:
        """Width of the transformer: 384, 768 or 1024."""
        return int(self._model.embed_dim)

    @property
    def fingerprint(self) -> str:
        """Changes with whatever else than the pictures decides the maps."""
        return f"{self.name} {self.cell_px} {_file_hash(self.weights, _stamp(self.weights))}"

    def maps(
        self,
        images: np.ndarray,
        depth_m: np.ndarray | None = None,
        cameras: Sequence[Camera] | None = None,
    ) -> np.ndarray:
        """Maps (V, H / cell_px, W / cell_px, D); see `FeatureBackend.maps`."""
        import torch

        if images.ndim != 4 or images.shape[3] != 3 or images.dtype != np.uint8:
            raise ShapeError(
                f"images: expected (V, H, W, 3) uint8 RGB, got {images.shape} {images.dtype}"
            )
        rows, columns = (max(1, round(n / self.cell_px)) for n in images.shape[1:3])
        with torch.inference_mode():
            pictures = self._prepared(images, rows, columns)
            tokens = self._model.forward_features(pictures)[:, self._model.num_prefix_tokens :]
        maps = tokens.reshape(len(images), rows, columns, self.dimensions)
        return np.asarray(maps.float().cpu().numpy())

    def _prepared(self, images: np.ndarray, rows: int, columns: int) -> torch.Tensor:
        """Pictures as the network takes them: (V, 3, rows * patch, columns * patch)."""
        import torch

        patch = self._model.patch_embed.patch_size[0]
        pictures = torch.from_numpy(images).to(self.device).permute(0, 3, 1, 2).float() / 255
        pictures = torch.nn.functional.interpolate(
            pictures,
            size=(rows * patch, columns * patch),
            mode="bicubic",
            antialias=True,
            align_corners=False,
        )
        mean, std = (
            torch.tensor(c, device=self.device)[:, None, None] for c in (MEAN_RGB, STD_RGB)
        )
        return (pictures.clamp(0, 1) - mean) / std


def find_weights(variants: Sequence[str]) -> Path:
    """The first weights on this machine: our cache, torch's, then that of the Hugging Face hub.

    Args:
        variants: Keys of `FILES`, in the order of preference.

    Raises:
        SetupError: There are none; the message says where to put them.
    """
    import torch
    from huggingface_hub import try_to_load_from_cache

    own = cache_folder() / "weights"
    for variant in variants:
        file, repository = FILES[variant]
        for folder in (own, Path(torch.hub.get_dir()) / "checkpoints"):
            if (folder / file).is_file():
                return folder / file
        cached = try_to_load_from_cache(repository, "model.safetensors")
        if isinstance(cached, str):
            return Path(cached)
    file, repository = FILES[variants[0]]
    raise SetupError(
        f"no DINOv2 weights on this machine: put {file}, as Meta publishes it, into {own}, or run "
        f"`hf download {repository} model.safetensors`, or pass the path of either file; "
        "the built-in backend `builtin` needs no download"
    )


@functools.lru_cache(1)
def _load(weights: Path, device: str, stamp: object) -> Any:
    """Build the transformer that the weights are of, with dynamic picture size; kept once built.

    `stamp` changes with the file, so that another one under the same name is another network.
    """
    try:
        from timm.models import load_state_dict
        from timm.models.vision_transformer import VisionTransformer, checkpoint_filter_fn
    except ImportError:
        raise SetupError(
            "the dinov2 backend needs timm: pip install 'codediffuser[dinov2]'"
        ) from None
    if not weights.is_file():
        raise SetupError(f"{weights}: no such file; expected the weights of a DINOv2")
    try:
        state = load_state_dict(str(weights), weights_only=True)
        model = VisionTransformer(**_architecture(state))
        model.load_state_dict(checkpoint_filter_fn(state, model), strict=True)
    except Exception as error:  # whatever a damaged or foreign file leads torch and timm to
        raise SetupError(
            f"{weights}: these are no weights of a DINOv2 ViT-S, B or L in Meta's or timm's form "
            f"({type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''})"
        ) from None
    return model.to(device).eval()


def _architecture(state: dict[str, Any]) -> dict[str, Any]:
    """What timm's `VisionTransformer` must be built with to fit the weights."""
    width, _, patch, _ = state["patch_embed.proj.weight"].shape
    registers = next((state[k].shape[1] for k in ("register_tokens", "reg_token") if k in state), 0)
    # With registers, timm's own files keep the class token out of the positions; Meta's have it.
    positions = state["pos_embed"].shape[1] - (0 if "reg_token" in state else 1)
    blocks = {k.split(".")[1] for k in state if k.startswith("blocks.")}
    return {
        "img_size": patch * round(positions**0.5),
        "patch_size": patch,
        "embed_dim": width,
        "depth": len(blocks),
        "num_heads": width // HEAD_WIDTH,
        "mlp_ratio": state["blocks.0.mlp.fc1.weight"].shape[0] / width,
        "init_values": 1e-5,
        "reg_tokens": registers,
        "no_embed_class": registers > 0,
        "num_classes": 0,
        "global_pool": "token",
        "dynamic_img_size": True,
    }


def _stamp(path: Path) -> tuple[int, int]:
    """Changes when a file is written anew; (0, 0) for none."""
    if not path.is_file():
        return 0, 0
    found = path.stat()
    return found.st_mtime_ns, found.st_size


@functools.cache
def _file_hash(path: Path, stamp: object) -> str:
    return sha256_file(path)


def _from_options(variants: Sequence[str], options: FeatureOptions) -> FeatureBackend:
    backend = DinoV2(options.weights or find_weights(variants), device=options.device)
    if options.cache is None:
        return backend
    return CachedFeatures(backend, options.cache, backend.fingerprint)


for _variant in FILES:
    FEATURES.add(f"dinov2-{_variant}")(functools.partial(_from_options, (_variant,)))
FEATURES.add("dinov2")(functools.partial(_from_options, tuple(FILES)))
