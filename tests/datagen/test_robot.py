"""The light Panda: built once, same physics, same look, fewer triangles."""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh

from codediffuser.datagen import assets

pytest.importorskip("mani_skill")


@pytest.fixture(scope="module")
def stock() -> Path:
    return assets._stock_urdf()


@pytest.fixture(scope="module")
def light() -> Path:
    return assets.panda_urdf()


def meshes(urdf: Path, kind: str) -> list[Path]:
    tree = ET.parse(urdf)
    return [urdf.parent / m.attrib["filename"] for m in tree.iterfind(f".//{kind}/geometry/mesh")]


def part_colors(scene: trimesh.Scene) -> set[tuple[int, ...]]:
    return {tuple(g.visual.material.baseColorFactor) for g in scene.geometry.values()}


def test_light_meshes_keep_to_their_number_of_triangles(light: Path) -> None:
    for path in meshes(light, "visual"):
        scene = trimesh.load_scene(path)
        count = sum(len(g.faces) for g in scene.geometry.values())
        assert count <= assets.TRIANGLES_PER_LINK * 1.05, path.name


def test_light_meshes_stand_where_the_stock_ones_do(stock: Path, light: Path) -> None:
    # Link meshes with a node transform would move by up to 0.26 m if it were dropped;
    # 5 mm is one and a half pixels of a 320x240 picture at the cameras' distance.
    for old, new in zip(meshes(stock, "visual"), meshes(light, "visual"), strict=True):
        a, b = trimesh.load_scene(old), trimesh.load_scene(new)
        np.testing.assert_allclose(a.bounds, b.bounds, atol=5e-3, err_msg=old.name)


def test_light_meshes_keep_their_colors(stock: Path, light: Path) -> None:
    for old, new in zip(meshes(stock, "visual"), meshes(light, "visual"), strict=True):
        assert part_colors(trimesh.load_scene(old)) == part_colors(trimesh.load_scene(new))


def test_collision_meshes_and_joints_are_the_stock_ones(stock: Path, light: Path) -> None:
    for old, new in zip(meshes(stock, "collision"), meshes(light, "collision"), strict=True):
        assert old.read_bytes() == new.read_bytes()
    for tag in ("joint", "inertial"):
        old, new = (
            [ET.canonicalize(ET.tostring(e)) for e in ET.parse(p).iter(tag)] for p in (stock, light)
        )
        assert old == new


def test_cache_folder_holds_everything_the_urdf_names(light: Path) -> None:
    assert all(p.is_file() and light.parent in p.parents for p in meshes(light, "visual"))
    assert all(p.is_file() and light.parent in p.parents for p in meshes(light, "collision"))
    assert light.with_suffix(".srdf").is_file()


def test_meshes_are_the_same_bytes_every_time(stock: Path, tmp_path: Path) -> None:
    mesh = meshes(stock, "visual")[0]
    for name in ("a.glb", "b.glb"):
        assets.decimate_glb(mesh, tmp_path / name, 300)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_two_processes_that_build_at_once_both_get_a_whole_robot(tmp_path: Path) -> None:
    code = "from codediffuser.datagen.assets import panda_urdf; print(panda_urdf())"
    environment = {**os.environ, "CODEDIFFUSER_CACHE": str(tmp_path), "OMP_NUM_THREADS": "1"}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    paths = {process.communicate(timeout=300)[0].strip().splitlines()[-1] for process in running}
    assert all(process.returncode == 0 for process in running)
    assert len(paths) == 1
    urdf = Path(paths.pop())
    assert tmp_path in urdf.parents
    assert all(p.is_file() for p in meshes(urdf, "visual"))
    assert not list(tmp_path.glob(".*")), "something half-built was left behind"


def test_hand_starts_above_the_table_pointing_down(expert_run) -> None:  # type: ignore[no-untyped-def]
    T = expert_run.trajectory.T_world_hand(0)
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.0, 0.30], atol=1e-3)
    np.testing.assert_allclose(T[:3, 2], [0.0, 0.0, -1.0], atol=1e-3)


def test_drives_and_finger_friction_are_the_documented_ones(physics) -> None:  # type: ignore[no-untyped-def]
    robot = physics.agent.robot._objs[0]
    arm, fingers = robot.active_joints[:7], robot.active_joints[7:]
    assert {(j.stiffness, j.damping, j.force_limit) for j in arm} == {(1800, 180, 100)}
    assert {(j.stiffness, j.damping, j.force_limit) for j in fingers} == {(1200, 60, 360)}
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        link = physics.agent.robot.links_map[finger]._objs[0]
        materials = {
            (s.physical_material.static_friction, s.physical_material.dynamic_friction)
            for s in link.collision_shapes
        }
        assert materials == {(1.5, 1.0)}
