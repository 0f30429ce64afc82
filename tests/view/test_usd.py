"""USD stages: they hold the rollout exactly, and USD's own validators have nothing to say."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from pxr import Usd, UsdGeom, UsdShade, UsdValidation

from warpvox.errors import RolloutError
from warpvox.palette import colour_index
from warpvox.view.rollout import Rollout
from warpvox.view.usd import write_usd


def findings(path: Path) -> list[str]:
    """What all of USD's validators say of a file."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [f"{error.GetName()}: {error.GetMessage()}" for error in errors]


def mesh_of(stage: Usd.Stage, env: int) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/env_{env:03d}/voxels"))


@settings(max_examples=12)
@given(
    frames=st.integers(1, 12),
    envs=st.integers(1, 4),
    designs=st.integers(1, 3),
    seed=st.integers(0, 99),
    end=st.integers(1, 11),
    suffix=st.sampled_from([".usdc", ".usd", ".usda"]),
)
def test_reopened_stage_equals_the_rollout(
    rollouts, tmp_path_factory, frames, envs, designs, seed, end, suffix
) -> None:
    rollout = rollouts(frames, envs, designs, seed, ends=(end,) if end < frames else ())
    path = write_usd(rollout, tmp_path_factory.mktemp("usd") / f"rollout{suffix}")
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    stage = Usd.Stage.Open(str(path))
    for env in range(envs):
        scene, mesh = rollout.scene(env), mesh_of(stage, env)
        for frame in range(frames):
            points = np.array(mesh.GetPointsAttr().Get(frame))
            np.testing.assert_array_equal(points[:, :2], rollout.positions[frame, env, : scene.num_points])
            np.testing.assert_array_equal(points[:, 2], 0)
            shown = np.array(mesh.GetDisplayColorPrimvar().GetIndicesAttr().Get(frame))
            np.testing.assert_array_equal(shown, colour_index(scene.cells, rollout.stretch(frame, env)))
    assert findings(path) == []


def test_stage_metadata(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(25, 2, ends=(10,))
    rollout.metadata |= {"big": 2**40, "list": [1], "odd key": "yes"}
    stage = Usd.Stage.Open(str(write_usd(rollout, tmp_path / "rollout.usdc")))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 24, 50)
    world = stage.GetDefaultPrim()
    assert world.GetCustomDataByKey("warpvox:task") == "Walker-v0"
    assert world.GetCustomDataByKey("warpvox:odd_key") == "yes"
    env = stage.GetPrimAtPath("/World/env_000")
    assert env.GetCustomDataByKey("warpvox:return") == pytest.approx(rollout.returns[-1, 0])
    assert env.GetCustomDataByKey("warpvox:length") == 10
    kinds = {prim.GetTypeName() for prim in stage.Traverse()}
    assert {"Mesh", "GeomSubset", "Material", "Camera", "DistantLight", "DomeLight"} <= kinds


def test_every_face_has_its_material(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(3, 1)
    stage = Usd.Stage.Open(str(write_usd(rollout, tmp_path / "rollout.usdc")))
    mesh, cells = mesh_of(stage, 0), rollout.scene(0).cells
    names = {1: "rigid", 2: "soft", 3: "horizontal_actuator", 4: "vertical_actuator", 5: "fixed"}
    covered = np.zeros(len(cells), int)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        faces = np.array(subset.GetIndicesAttr().Get())
        covered[faces] += 1
        material, _ = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()
        assert material.GetPrim().GetName() == subset.GetPrim().GetName()
        assert {names[cell] for cell in cells[faces].tolist()} == {subset.GetPrim().GetName()}
    assert (covered == 1).all()


def test_faces_look_towards_the_camera(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(write_usd(rollouts(2, 1), tmp_path / "rollout.usdc")))
    for name in ("voxels", "terrain"):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/env_000/{name}"))
        quads = np.array(mesh.GetPointsAttr().Get(0))[np.array(mesh.GetFaceVertexIndicesAttr().Get())].reshape(-1, 4, 3)
        assert (np.cross(quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 1])[:, 2] > 0).all()
        low, high = np.array(mesh.GetExtentAttr().Get())
        assert (quads >= low - 1e-6).all()
        assert (quads <= high + 1e-6).all()


def test_terrain_is_that_of_the_scene(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(2, 1)
    stage = Usd.Stage.Open(str(write_usd(rollout, tmp_path / "rollout.usdc")))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/env_000/terrain"))
    quads = np.array(mesh.GetPointsAttr().Get())[np.array(mesh.GetFaceVertexIndicesAttr().Get())].reshape(-1, 4, 3)
    shown = np.zeros_like(rollout.scene(0).terrain)
    for x, y in np.floor(quads.mean(axis=1)[:, :2] * 10).astype(int):
        shown[len(shown) - 1 - y, x] = 5
    np.testing.assert_array_equal(shown, rollout.scene(0).terrain)


def test_chosen_environments_and_stride(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(11, 4)
    stage = Usd.Stage.Open(str(write_usd(rollout, tmp_path / "rollout.usdc", envs=[3, 1, 3], stride=5)))
    names = [prim.GetName() for prim in stage.GetDefaultPrim().GetChildren()]
    assert [name for name in names if name.startswith("env_")] == ["env_003", "env_001"]  # each once
    samples = mesh_of(stage, 3).GetPointsAttr().GetTimeSamples()
    assert samples == [0, 5, 10]
    assert stage.GetEndTimeCode() == 10


@pytest.mark.parametrize(
    ("name", "options"), [("rollout.obj", {}), ("rollout.usdc", {"envs": [9]}), ("rollout.usdc", {"stride": 0})]
)
def test_wrong_requests_get_one_clear_line(rollouts, tmp_path: Path, name: str, options) -> None:
    with pytest.raises(RolloutError):
        write_usd(rollouts(3, 1), tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_a_stage_that_does_not_fit_is_refused(rollouts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rollout = rollouts(2000, 1)
    monkeypatch.setattr("warpvox.view.usd.free_memory", lambda device: 1_000_000)
    with pytest.raises(RolloutError):
        write_usd(rollout, tmp_path / "long.usd")
    assert not list(tmp_path.iterdir())
    write_usd(rollout, tmp_path / "long.usd", stride=2)
