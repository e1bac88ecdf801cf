"""The Panda with light visual meshes, built once per machine from ManiSkill's own assets.

The stock visual meshes hold 135 000 triangles on unshared vertices and alone cap five-camera
rendering on a CPU at about eight sets per second. Collision meshes, inertias and joints stay as
they are, so physics is that of the stock robot.

Mesh licence: `franka_description`, Apache-2.0, as ManiSkill ships it.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import importlib.metadata
import importlib.util
import logging
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codediffuser.errors import SetupError
from codediffuser.files import atomic_folder, cache_folder, remove_partials

logger = logging.getLogger(__name__)

TRIANGLES_PER_LINK = 1200
"""Measured on a set of five 160x120 pictures: 2000 cost 31 ms of CPU time, 1200 22 ms, no robot
10 ms. Below 1000 the dark and light parts of a link begin to cut into each other."""

BUILD_VERSION = 2
"""Raise it when the code below makes other files from the same input."""

CREASE_RAD = 1.0
"""Edges sharper than this stay sharp when normals are smoothed; each one kept costs vertices."""


def panda_urdf() -> Path:
    """Path of the light Panda's URDF, which is built first if this machine has none.

    Safe when several processes ask at once: one builds, the others wait for it.

    Raises:
        SetupError: ManiSkill's Panda is not where its package should hold it.
    """
    return _built_urdf(cache_folder())


@functools.cache
def _built_urdf(cache: Path) -> Path:
    source = _stock_urdf()
    folder = cache / f"panda-{_fingerprint(source)}"
    urdf = folder / "panda.urdf"
    if urdf.is_file():
        return urdf
    with _locked(folder.with_suffix(".lock")):
        if not urdf.is_file():
            remove_partials(folder.parent)
            logger.info("building the light Panda in %s", folder)
            with atomic_folder(folder) as partial:
                build_light_robot(source, partial / "panda.urdf")
    return urdf


def build_light_robot(
    source: Path, target: Path, *, triangles_per_link: int = TRIANGLES_PER_LINK
) -> None:
    """Write `target` (a URDF) with meshes beside it, light versions of those of `source`.

    Visual meshes are decimated; collision meshes and the SRDF (pairs that never collide) are
    copied, so that the folder stands alone.
    """
    tree = ET.parse(source)
    for kind in ("visual", "collision"):
        (target.parent / kind).mkdir(parents=True, exist_ok=True)
        for mesh in tree.iterfind(f".//{kind}/geometry/mesh"):
            original = source.parent / mesh.attrib["filename"]
            light = Path(kind) / original.name
            mesh.attrib["filename"] = str(light)
            if (target.parent / light).exists():
                continue
            if kind == "visual":
                decimate_glb(original, target.parent / light, triangles_per_link)
            else:
                shutil.copyfile(original, target.parent / light)
    shutil.copyfile(source.with_suffix(".srdf"), target.with_suffix(".srdf"))
    tree.write(target, encoding="utf-8", xml_declaration=True)


def decimate_glb(source: Path, target: Path, triangles: int) -> None:
    """Write a GLB with about `triangles` triangles: same parts, colours and node transforms.

    Each part keeps its share of the triangles. A file that has fewer stays as it is in shape.
    """
    import trimesh
    from trimesh.graph import smooth_shade

    scene = trimesh.load_scene(source)
    total = sum(
        len(scene.geometry[scene.graph[node][1]].faces) for node in scene.graph.nodes_geometry
    )
    light = trimesh.Scene()
    for number, node in enumerate(scene.graph.nodes_geometry):
        T_link_part, name = scene.graph[node]
        part = scene.geometry[name]
        wanted = max(round(triangles * len(part.faces) / total), 16)
        body = _decimated(np.asarray(part.vertices), np.asarray(part.faces), wanted)
        # Node transforms are baked in: a loader that ignores them draws the same picture.
        body.apply_transform(T_link_part)
        body = smooth_shade(body, angle=CREASE_RAD)
        body.visual = trimesh.visual.TextureVisuals(material=part.visual.material)
        # The source's parts get random names when loaded; files must be the same every time.
        body.metadata.clear()
        light.add_geometry(body, node_name=f"part_{number}", geom_name=f"part_{number}")
    target.write_bytes(light.export(file_type="glb", include_normals=True))


def _decimated(vertices: np.ndarray, faces: np.ndarray, triangles: int):  # type: ignore[no-untyped-def]
    """Quadric decimation of a triangle soup; vertices that coincide are joined first."""
    import fast_simplification
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    if len(mesh.faces) <= triangles:
        return mesh
    points, cells = fast_simplification.simplify(
        np.asarray(mesh.vertices, dtype=np.float32),
        np.asarray(mesh.faces, dtype=np.int32),
        target_count=triangles,
    )
    return trimesh.Trimesh(points, cells, process=True)


def _stock_urdf() -> Path:
    # Found without importing it, which takes seconds.
    package = importlib.util.find_spec("mani_skill")
    roots = (package and package.submodule_search_locations) or ["mani_skill"]
    path = Path(roots[0]) / "assets" / "robots" / "panda" / "panda_v2.urdf"
    if not path.is_file():
        raise SetupError(
            f"{path}: ManiSkill's Panda is missing; install it again with "
            "'pip install --force-reinstall mani-skill'"
        )
    return path


def _fingerprint(source: Path) -> str:
    """Hash of what the result depends on: input files, parameters, versions of the tools."""
    digest = hashlib.sha256()
    for part in (BUILD_VERSION, TRIANGLES_PER_LINK, CREASE_RAD):
        digest.update(f"{part};".encode())
    for package in ("trimesh", "fast-simplification"):
        digest.update(f"{package}={importlib.metadata.version(package)};".encode())
    meshes = source.parent / "franka_description" / "meshes"
    for path in (source, *sorted(meshes.glob("*/*.glb")), *sorted(meshes.glob("*/*.stl"))):
        # Size instead of content: this runs in every process, and the wheel never edits in place.
        digest.update(f"{path.name}:{path.stat().st_size};".encode())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock on a file; a killed holder releases it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(stream, fcntl.LOCK_UN)
