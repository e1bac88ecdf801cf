"""Name the Vulkan devices and render one frame with SAPIEN; what `codediffuser doctor` runs.

`python -m codediffuser.datagen.render_probe` runs it in a process of its own, since a broken driver
crashes the process instead of raising. Each answer is one line of JSON, written at once.
"""

from __future__ import annotations

import ctypes
import json
import sys
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

VK_API_1_2 = (1 << 22) | (2 << 12)
LAVAPIPE_DRIVER_ID = 13
"""`VK_DRIVER_ID_MESA_LLVMPIPE`."""

# Values of `VkStructureType`.
_APPLICATION_INFO = 0
_INSTANCE_CREATE_INFO = 1
_PROPERTIES_2 = 1000059001
_DRIVER_PROPERTIES = 1000196000


@dataclass(frozen=True, slots=True)
class VulkanDevice:
    """What the Vulkan loader says of one device."""

    name: str
    """`llvmpipe (LLVM 15.0.6, 256 bits)`"""
    driver: str
    """The driver's own words on its version: `Mesa 25.0.7`."""
    is_lavapipe: bool


class _ApplicationInfo(ctypes.Structure):
    _fields_ = (
        ("structure_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("application_name", ctypes.c_char_p),
        ("application_version", ctypes.c_uint32),
        ("engine_name", ctypes.c_char_p),
        ("engine_version", ctypes.c_uint32),
        ("api_version", ctypes.c_uint32),
    )


class _InstanceCreateInfo(ctypes.Structure):
    _fields_ = (
        ("structure_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application_info", ctypes.POINTER(_ApplicationInfo)),
        ("layer_count", ctypes.c_uint32),
        ("layer_names", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extension_names", ctypes.c_void_p),
    )


class _Properties2(ctypes.Structure):
    _fields_ = (
        ("structure_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        # VkPhysicalDeviceProperties: five numbers, the name, then 544 bytes of limits. Longer does
        # no harm.
        ("numbers", ctypes.c_uint32 * 5),
        ("name", ctypes.c_char * 256),
        ("rest", ctypes.c_uint64 * 128),
    )


class _DriverProperties(ctypes.Structure):
    _fields_ = (
        ("structure_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("driver_id", ctypes.c_int),
        ("driver_name", ctypes.c_char * 256),
        ("driver_info", ctypes.c_char * 256),
        ("conformance", ctypes.c_uint8 * 4),
    )


def vulkan_devices() -> list[VulkanDevice]:
    """Ask the Vulkan loader for its devices; empty when it knows no driver.

    Raises:
        OSError: The loader `libvulkan.so.1` is not installed.

    Source: Vulkan 1.2 specification, sec. 4.2 and 5.1.
    """
    vulkan = ctypes.CDLL("libvulkan.so.1")
    application = _ApplicationInfo(structure_type=_APPLICATION_INFO, api_version=VK_API_1_2)
    create_info = _InstanceCreateInfo(
        structure_type=_INSTANCE_CREATE_INFO,
        application_info=ctypes.pointer(application),
    )
    instance = ctypes.c_void_p()
    if vulkan.vkCreateInstance(ctypes.byref(create_info), None, ctypes.byref(instance)) != 0:
        return []
    try:
        count = ctypes.c_uint32()
        vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
        handles = (ctypes.c_void_p * count.value)()
        vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        return [_device_properties(vulkan, handle) for handle in handles]
    finally:
        vulkan.vkDestroyInstance(instance, None)


def _device_properties(vulkan: ctypes.CDLL, handle: int | None) -> VulkanDevice:
    driver = _DriverProperties(structure_type=_DRIVER_PROPERTIES)
    properties = _Properties2(structure_type=_PROPERTIES_2, next=ctypes.addressof(driver))
    vulkan.vkGetPhysicalDeviceProperties2(ctypes.c_void_p(handle), ctypes.byref(properties))
    return VulkanDevice(
        name=properties.name.decode(),
        driver=driver.driver_info.decode(),
        is_lavapipe=driver.driver_id == LAVAPIPE_DRIVER_ID,
    )


def render_red_box() -> np.ndarray:
    """Render a red box that fills the middle of the picture.

    Returns:
        rgb: (24, 32, 3) float32, linear.
    """
    import sapien

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem("cpu")])
    scene.set_ambient_light([0.6, 0.6, 0.6])
    builder = scene.create_actor_builder()
    builder.add_box_visual(half_size=[0.1, 0.1, 0.1], material=[1.0, 0.0, 0.0])
    builder.set_initial_pose(sapien.Pose([0.5, 0.0, 0.0]))
    builder.build_static(name="box")
    camera = scene.add_camera("camera", width=32, height=24, fovy=1.0, near=0.1, far=10.0)
    scene.update_render()
    camera.take_picture()
    return np.asarray(camera.get_picture("Color"))[..., :3]


def main() -> None:
    """Write `{"devices": [...]}`, then, if the driver survives, `{"middle_rgb": [r, g, b]}`."""
    _write({"devices": [asdict(device) for device in vulkan_devices()]})
    _write({"middle_rgb": render_red_box()[12, 16].tolist()})


def _write(answer: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
