"""The bookshelf: scenes within their ranges, books at rest, titles legible, success earned."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from codediffuser.datagen import drawing
from codediffuser.datagen.book_slots import middle_x_m, row_beside, shelved_books
from codediffuser.datagen.cameras import camera_parameters
from codediffuser.datagen.scene import ObjectSpec, SceneSpec
from codediffuser.datagen.scene_sampler import sample_scene
from codediffuser.datagen.spine import spine_image
from codediffuser.datagen.stowing_script import hand_rotation
from codediffuser.datagen.task import SceneView
from codediffuser.datagen.tasks.stow_book import StowBook, StowBookConfig
from codediffuser.datagen.views import Moment, join_moments
from codediffuser.errors import ConfigError
from codediffuser.poses import apply_transform, make_transform, rotation_z

if TYPE_CHECKING:
    from codediffuser.datagen.envs import SceneEnv

HAND_AWAY = make_transform(hand_rotation(0.0, 0.7), np.array([0.4, -0.4, 0.3]))
LEANING = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])


@pytest.fixture
def hand_away() -> np.ndarray:
    return HAND_AWAY


@pytest.fixture(scope="module")
def task() -> StowBook:
    return StowBook()


@pytest.fixture(scope="module")
def drawn(task: StowBook) -> list[SceneSpec]:
    return [sample_scene(task, root_seed=5, index=i) for i in range(60)]


@pytest.fixture(scope="module")
def real(task: StowBook) -> list[SceneSpec]:
    return [sample_scene(task, root_seed=5, index=i, variant="real") for i in range(30)]


@pytest.fixture(scope="module")
def scene(task: StowBook) -> SceneSpec:
    return sample_scene(task, root_seed=0, index=0, places=4)


@pytest.fixture
def solved(scene: SceneSpec, make_view: Callable[..., SceneView]) -> Callable[..., SceneView]:
    """The target book stands in the target slot; the arguments change that."""

    def make(
        offset_m: tuple[float, float, float] = (0, 0, 0),
        R: np.ndarray | None = None,
        **state: object,
    ) -> SceneView:
        at = np.array(scene.place(scene.target.place).position_m) + offset_m
        pose = make_transform(np.eye(3) if R is None else R, at)
        return make_view(scene, {scene.target.pick: pose}, **state)

    return make


def leaning(scene: SceneSpec) -> list[ObjectSpec]:
    return [o for o in shelved_books(scene) if o.T_world_object[2, 2] < 0.9999]


def test_one_or_two_books_lean_and_open_two_to_four_slots(drawn: list[SceneSpec]) -> None:
    assert {len(leaning(scene)) for scene in drawn} == {1, 2}
    assert {scene.ambiguity.places for scene in drawn} == {2, 3, 4}
    for scene in drawn:
        assert scene.ambiguity.picks == 1
        assert (len(leaning(scene)) == 1) == (scene.ambiguity.places == 2)


def test_four_large_books_stand_fixed_at_the_sides(drawn: list[SceneSpec]) -> None:
    orders = set()
    for scene in drawn:
        row = shelved_books(scene)
        assert [o.fixed for o in row] == [True, True, *[False] * (len(row) - 4), True, True]
        assert [row[i].label for i in (0, 1, -2, -1)] == [
            "GARDENS",
            "BRIDGES",
            "VOYAGES",
            "DESERTS",
        ]
        assert min(o.shape["height_m"] for o in row if o.fixed) > max(
            o.shape["height_m"] for o in row if not o.fixed
        )
        orders.add(tuple(o.label for o in row[2:-2]))
    assert len(orders) > 50


def test_titles_are_unique_and_colors_are_those_of_the_catalogue(
    task: StowBook, drawn: list[SceneSpec]
) -> None:
    for scene in drawn:
        books = [o for o in scene.objects if o.category == "book"]
        assert len({o.label for o in books}) == len(books)
        for o in books:
            assert o.name == f"{task.config.books.catalogue[o.label or ''].color} book"


def test_the_waiting_book_stands_on_the_pad(task: StowBook, drawn: list[SceneSpec]) -> None:
    (pad,) = task.pads("sim")
    for scene in drawn:
        (book,) = scene.pickable
        assert book.position_m[2] == 0
        outline = [[x, y, 0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)] * np.array(
            [book.shape["thickness_m"], book.shape["depth_m"], 1]
        )
        corners = apply_transform(book.T_world_object, outline)[:, :2]
        assert np.all((corners > pad.low_m) & (corners < pad.high_m))


def test_the_real_shelf_always_holds_the_same_seven_books(real: list[SceneSpec]) -> None:
    titles = {frozenset(o.label for o in shelved_books(s) if not o.fixed) for s in real}
    assert len(titles) == 1 and len(next(iter(titles))) == 7
    assert {len(leaning(s)) for s in real} == {1, 2}


def test_picks_and_places_that_cannot_be_are_refused(task: StowBook) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ConfigError, match="picks: waiting books: expected 1, got 2"):
        task.sample_layout(rng, picks=2)
    with pytest.raises(ConfigError, match="places: free slots: expected 2 to 4, got 5"):
        task.sample_layout(rng, places=5)
    with pytest.raises(ConfigError, match="Unknown variant 'reel'"):
        task.sample_layout(rng, variant="reel")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pad_books: [ECHO", "pad_books: [ECHOES", "Unknown title 'ECHOES'"),
        ("count: [5, 6]", "count: [5, 9]", "row.count: expected 1 <= low <= high <= 7"),
        ("color: orange", "color: ornage", "'ornage' is no key of books.colors"),
    ],
)
def test_mistakes_in_the_yaml_are_named(old: str, new: str, message: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "stow_book.yaml"
    text = StowBook.config_path().read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        StowBookConfig.load(path)


def test_a_slot_lies_between_its_neighbours(drawn: list[SceneSpec]) -> None:
    for scene in drawn:
        for place in scene.free_places:
            left, right = row_beside(scene, place.id)
            x = place.position_m[0]
            assert middle_x_m(left[-1].T_world_object, left[-1]) < x
            assert x < middle_x_m(right[0].T_world_object, right[0])
            assert left[-1] in leaning(scene) or right[0] in leaning(scene)


def test_a_stowed_book_is_a_success(task: StowBook, solved: Callable[..., SceneView]) -> None:
    view = solved()
    check = task.check_success(view, view.scene.instruction.pairs)
    assert check.success, check.reason
    assert check.pair == (view.scene.target.pick, view.scene.target.place)


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ({"offset_m": (0, -0.02, 0)}, "depth_error_m"),
        ({"offset_m": (0, 0, 0.01)}, "base_height_m"),
        ({"R": LEANING}, "upright"),
        ({"R": rotation_z(np.pi)}, "spine_out"),
        ({"speed": (0.05, 0.0)}, "speed_mps"),
        ({"speed": (0.0, 1.0)}, "spin_radps"),
    ],
)
def test_what_is_amiss_is_named(
    task: StowBook, solved: Callable[..., SceneView], state: dict[str, object], reason: str
) -> None:
    view = solved(**state)
    pair = (view.scene.target.pick, view.scene.target.place)
    assert reason in task.check_success(view, [pair]).reason


def test_a_book_in_the_hand_is_not_released(
    task: StowBook, solved: Callable[..., SceneView]
) -> None:
    view = solved()
    near = make_transform(hand_rotation(0.0, 0.7), view.T_world_object("book_00")[:3, 3])
    held = solved(hand=near, opening_m=0.012)
    pair = (view.scene.target.pick, view.scene.target.place)
    assert task.check_success(held, [pair]).reason == "released_opening_m"


def test_another_slot_is_no_success(task: StowBook, solved: Callable[..., SceneView]) -> None:
    view = solved()
    pick, place = view.scene.target.pick, view.scene.target.place
    for other in view.scene.free_places:
        assert task.check_success(view, [(pick, other.id)]).success == (other.id == place)


def test_a_row_that_was_knocked_out_is_no_success(
    task: StowBook, solved: Callable[..., Any]
) -> None:
    view = solved()
    victim = next(o for o in shelved_books(view.scene) if not o.fixed)
    view.poses[victim.id] = victim.T_world_object.copy()
    view.poses[victim.id][1, 3] -= 0.05
    pair = (view.scene.target.pick, view.scene.target.place)
    assert "row_shift_m" in task.check_success(view, [pair]).reason


def failure(task: StowBook, scene: SceneSpec, *waiting: np.ndarray, opening_m: float = 0.04) -> str:
    """Failure phase of a trajectory in which only the waiting book moves, through given poses."""
    movable = [o for o in scene.objects if not o.fixed]
    moments = []
    for T in (scene.pickable[0].T_world_object, *waiting):
        poses = [T if o.place is None else o.T_world_object for o in movable]
        quats = [o.quat_wxyz for o in movable]
        moments.append(
            Moment(
                object_position_m=np.array([P[:3, 3] for P in poses]),
                object_quat_wxyz=np.array(quats),
                object_velocity=np.zeros((len(movable), 6)),
                qpos=np.array([0.0] * 7 + [opening_m] * 2), qvel=np.zeros(9),
                hand_position_m=T[:3, 3], hand_quat_wxyz=np.array([1.0, 0, 0, 0]),
            )
        )  # fmt: skip
    actions = [np.zeros(10)] * len(waiting)
    trajectory = join_moments([o.id for o in movable], moments, actions)
    return task.failure_phase(scene, trajectory, scene.instruction.pairs)


def test_failures_are_told_apart(task: StowBook, scene: SceneSpec) -> None:
    start = scene.pickable[0].T_world_object

    def at(x: float, y: float, z: float) -> np.ndarray:
        moved = start.copy()
        moved[:3, 3] = (x, y, z)
        return moved

    lifted, (x, y, z) = at(0.1, 0.0, 0.1), scene.place(scene.target.place).position_m
    shelf_x = task.config.shelf.spine_y_m
    assert failure(task, scene, start) == "grasp:missed"
    assert failure(task, scene, lifted, opening_m=0.01) == "transport:timeout"
    assert failure(task, scene, lifted, at(x, shelf_x - 0.05, z)) == "push:blocked"
    assert failure(task, scene, lifted, at(0.2, 0.0, 0.0)) == "transport:dropped"
    assert failure(task, scene, lifted, at(x, y, z), opening_m=0.01) == "release:not_released"
    assert failure(task, scene, lifted, at(x + 0.3, y, z)) == "push:wrong_slot"


def test_the_picture_shows_every_title_and_the_target(task: StowBook, scene: SceneSpec) -> None:
    front, above = task.draw_reset(scene).panels
    words = {s.text for s in front.shapes if isinstance(s, drawing.Text)}
    assert {o.label for o in shelved_books(scene)} <= words
    green = [s for s in front.shapes if isinstance(s, drawing.Polygon) and s.edge == drawing.TARGET]
    assert len(green) == 1
    xs = [x for x, _ in green[0].corners_m]
    place_x = scene.place(scene.target.place).position_m[0]
    assert min(xs) - 0.03 < place_x < max(xs) + 0.03
    assert scene.pickable[0].label in {s.text for s in above.shapes if isinstance(s, drawing.Text)}
    crosses = [s.center_m for s in above.shapes if isinstance(s, drawing.Cross)]
    assert crosses == task.pads(scene.variant)[0].crosses_m()


@pytest.fixture(scope="module")
def physics(task: StowBook, drawn: list[SceneSpec]) -> SceneEnv:
    from codediffuser.datagen.envs import physics_env

    return physics_env(task, drawn[0])


@pytest.mark.sim
def test_leaning_books_are_at_rest_from_the_start(
    physics: SceneEnv, drawn: list[SceneSpec]
) -> None:
    for scene in drawn[:8]:
        physics.reset(options={"scene": scene})
        for obj in (o for o in scene.objects if not o.fixed):
            T = physics.view.T_world_object(obj.id)
            np.testing.assert_allclose(T, obj.T_world_object, atol=0.006)
            assert max(physics.view.object_speed(obj.id)) < 0.03
        assert not physics.check().success


@pytest.mark.sim
@pytest.mark.parametrize("places", [2, 3, 4])
def test_the_expert_stows_the_book(task: StowBook, physics: SceneEnv, places: int) -> None:
    from codediffuser.datagen.script import run_expert

    scene = sample_scene(task, root_seed=11, index=places, places=places)
    run = run_expert(physics, scene, np.random.default_rng(places))
    assert run.success, run.failure_reason
    assert run.trajectory.num_steps < task.config.max_steps
    pushed = [
        np.linalg.norm(run.trajectory.T_world_object(o.id, -1)[:3, 3] - o.T_world_object[:3, 3])
        for o in leaning(scene)
    ]
    assert max(pushed) > 0.002


@pytest.mark.sim
def test_titles_can_be_read_in_the_camera_that_faces_the_shelf(
    task: StowBook, drawn: list[SceneSpec]
) -> None:
    """Each spine, cut out of a 320x240 picture, is most like its own title among all of them."""
    import cv2

    from codediffuser.datagen.rendering import Renderer

    renderer = Renderer(task)
    K, T_world_camera = camera_parameters(task.config.cameras)["shelf_front"]
    titles, size = list(task.config.books.catalogue), (24, 160)

    def grey(image: np.ndarray) -> np.ndarray:
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        values = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(float)
        return (values - values.mean()) / values.std()

    for scene in drawn[:2]:
        renderer.set_scene(scene)
        movable = [o for o in scene.objects if not o.fixed]
        picture = renderer.render(
            Moment(
                np.array([o.position_m for o in movable]), np.array([o.quat_wxyz for o in movable]),
                np.zeros((len(movable), 6)), np.array(task.config.robot.initial_qpos),
                np.zeros(9), np.zeros(3), np.array([1.0, 0, 0, 0]),
            )
        )["shelf_front"].rgb  # fmt: skip
        for book in shelved_books(scene):
            half_x, half_y = book.shape["thickness_m"] / 2, book.shape["depth_m"] / 2
            height = book.shape["height_m"]
            spine = [[x, -half_y, z] for z in (height, 0) for x in (-half_x, half_x)]
            camera = apply_transform(
                np.linalg.inv(T_world_camera) @ book.T_world_object, np.array(spine)
            )
            pixels = (camera @ K.T)[:, :2] / camera[:, 2:]
            flat = np.array([[0, 0], [95, 0], [0, 639], [95, 639]], dtype=np.float32)
            H = cv2.getPerspectiveTransform(pixels.astype(np.float32), flat)
            seen = grey(cv2.warpPerspective(picture, H, (96, 640)))[15:-15]
            likeness = {}
            for title in titles:
                print_ = spine_image(
                    title, book.color_rgb, 2 * half_x, height, task.config.books.titles
                )[:, :-16]
                likeness[title] = float((seen * grey(print_)[15:-15]).mean())
            assert max(likeness, key=lambda t: likeness[t]) == book.label
