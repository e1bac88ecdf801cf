from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codediffuser.errors import SetupError, ShapeError
from codediffuser.labeling.perception.dinov2 import DinoV2, find_weights
from codediffuser.labeling.perception.features import FeatureOptions, get_features

torch = pytest.importorskip("torch")
timm = pytest.importorskip("timm")

WIDTH = 64
IMAGES = np.random.default_rng(0).integers(0, 256, (3, 40, 60, 3), dtype=np.uint8)


def timm_model(registers: int = 0) -> Any:
    """timm's own ViT-S/14 of DINOv2, shrunk: random weights, every parameter different."""
    torch.manual_seed(0)
    name = "vit_small_patch14_reg4_dinov2" if registers else "vit_small_patch14_dinov2"
    model = timm.create_model(
        name, img_size=70, embed_dim=WIDTH, depth=2, num_heads=1, num_classes=0,
        dynamic_img_size=True,
    )  # fmt: skip
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(torch.randn_like(parameter) * 0.2 + 0.05)
    return model.eval()


def meta_state(model: Any) -> dict[str, Any]:
    """The same weights under the names of Meta's files."""
    state = dict(model.state_dict())
    state["mask_token"] = torch.zeros(1, WIDTH)
    if "reg_token" in state:
        state["register_tokens"] = state.pop("reg_token")
        class_position = torch.full((1, 1, WIDTH), 0.3)
        state["pos_embed"] = torch.cat([class_position, state["pos_embed"]], dim=1)
        state["cls_token"] = state["cls_token"] - class_position
    return state


@pytest.fixture
def save(tmp_path: Path) -> Callable[..., Path]:
    def write(model: Any, form: str) -> Path:
        if form == "timm":
            from safetensors.torch import save_file

            save_file(model.state_dict(), tmp_path / "model.safetensors")
            return tmp_path / "model.safetensors"
        torch.save(meta_state(model), tmp_path / "dinov2_tiny.pth")
        return tmp_path / "dinov2_tiny.pth"

    return write


def library_output(model: Any, images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """timm's own preprocessing, by its published means and deviations, and its own forward pass."""
    from PIL import Image
    from torchvision.transforms import InterpolationMode
    from torchvision.transforms.functional import normalize, resize, to_tensor

    config = timm.get_pretrained_cfg("vit_small_patch14_dinov2.lvd142m")
    pictures = [
        normalize(
            resize(
                to_tensor(Image.fromarray(i)), list(size), InterpolationMode.BICUBIC,
                antialias=True,
            ).clamp(0, 1),
            config.mean, config.std,
        )
        for i in images
    ]  # fmt: skip
    with torch.inference_mode():
        # NLC=False gives maps (D, h, w) of the last block, normalised, without other tokens.
        (features,) = model.forward_intermediates(
            torch.stack(pictures), indices=1, norm=True, intermediates_only=True
        )
    return np.asarray(features.permute(0, 2, 3, 1).numpy())


@pytest.mark.parametrize("registers", [0, 4])
@pytest.mark.parametrize("form", ["timm", "meta"])
def test_a_checkpoint_through_our_code_gives_the_librarys_own_output(
    save: Callable[..., Path], registers: int, form: str
) -> None:
    model = timm_model(registers)
    backend = DinoV2(save(model, form))
    maps = backend.maps(IMAGES)
    assert maps.shape == (3, 4, 6, WIDTH)
    assert maps.dtype == np.float32
    assert backend.dimensions == WIDTH
    expected = library_output(model, IMAGES, (4 * 14, 6 * 14))
    np.testing.assert_allclose(maps, expected, atol=2e-5)


def test_red_and_blue_are_not_the_same(save: Callable[..., Path]) -> None:
    # Upstream feeds BGR: an error that a symmetric test would miss.
    backend = DinoV2(save(timm_model(), "timm"))
    assert np.abs(backend.maps(IMAGES) - backend.maps(IMAGES[..., ::-1].copy())).max() > 0.1


def test_a_batch_is_its_pictures_one_by_one(save: Callable[..., Path]) -> None:
    backend = DinoV2(save(timm_model(), "timm"))
    one_by_one = np.concatenate([backend.maps(IMAGES[k : k + 1]) for k in range(3)])
    np.testing.assert_allclose(backend.maps(IMAGES), one_by_one, atol=1e-5)


def test_maps_are_kept_by_the_content_of_the_picture(
    save: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = FeatureOptions(weights=save(timm_model(), "timm"), cache=tmp_path / "cache")
    computed: list[int] = []
    original = DinoV2.maps

    def counting(self: DinoV2, images: np.ndarray, *args: Any) -> np.ndarray:
        computed.append(len(images))
        return original(self, images, *args)

    monkeypatch.setattr(DinoV2, "maps", counting)
    first = get_features("dinov2", options).maps(IMAGES[:2])
    again = get_features("dinov2", options).maps(IMAGES)
    assert computed == [2, 1]
    np.testing.assert_array_equal(again[:2], first)
    damaged = next((tmp_path / "cache").rglob("*.npy"))
    damaged.write_bytes(damaged.read_bytes()[:50])
    np.testing.assert_array_equal(get_features("dinov2", options).maps(IMAGES), again)
    assert computed == [2, 1, 1]


def test_other_weights_share_no_maps(save: Callable[..., Path], tmp_path: Path) -> None:
    path, cache = save(timm_model(), "timm"), tmp_path / "cache"
    first = get_features("dinov2", FeatureOptions(weights=path, cache=cache)).maps(IMAGES)
    model = timm_model()
    with torch.no_grad():
        model.norm.bias.add_(1)
    other = path.rename(tmp_path / "first.safetensors")
    assert other.is_file()
    options = FeatureOptions(weights=save(model, "timm"), cache=cache)
    np.testing.assert_allclose(get_features("dinov2", options).maps(IMAGES), first + 1, atol=1e-5)


def test_missing_weights_say_where_to_put_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CODEDIFFUSER_CACHE", str(tmp_path))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hf"))
    message = re.escape(f"put dinov2_vitb14_pretrain.pth, as Meta publishes it, into {tmp_path}")
    with pytest.raises(SetupError, match=message):
        get_features("dinov2-vitb14")
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights/dinov2_vitl14_pretrain.pth").touch()
    (tmp_path / "weights/dinov2_vitb14_pretrain.pth").touch()
    assert find_weights(["vits14", "vitb14", "vitl14"]).name == "dinov2_vitb14_pretrain.pth"


def test_foreign_and_damaged_weights_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"nothing\.pth: no such file"):
        DinoV2(tmp_path / "nothing.pth")
    (tmp_path / "torn.pth").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(SetupError, match=r"torn\.pth: these are no weights of a DINOv2"):
        DinoV2(tmp_path / "torn.pth")
    torch.save({"conv.weight": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(SetupError, match=r"other\.pth: these are no weights of a DINOv2.*KeyError"):
        DinoV2(tmp_path / "other.pth")


def test_pictures_must_be_rgb_bytes(save: Callable[..., Path]) -> None:
    backend = DinoV2(save(timm_model(), "timm"))
    with pytest.raises(
        ShapeError, match=r"expected \(V, H, W, 3\) uint8 RGB, got \(3, 40, 60, 3\) f"
    ):
        backend.maps(IMAGES.astype(np.float32))
