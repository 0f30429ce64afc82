"""Rollouts as USD stages: time-sampled meshes that usdview, Blender and Omniverse open.

``docs/formats.md`` describes the stage.
"""

# pyright: reportAttributeAccessIssue=false
# The stubs of pxr lack most of its classes.

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdShade, Vt

from warpvox.checks import check_integer
from warpvox.devices.out_of_memory import free_memory
from warpvox.errors import RolloutError
from warpvox.io.writing import atomic_path, check_suffix
from warpvox.palette import cell_colour, colour_index, palette
from warpvox.types import ACTUATORS, FRAME_SECONDS, MATERIALS, VOXEL, Cell
from warpvox.view.painter import camera_path
from warpvox.view.rollout import Rollout

_APERTURE = (20.955, 11.787)
"""Width and height of the camera sensor in mm (35 mm film cut to 16:9)."""
_FOCAL = 50.0
"""Focal length of the cameras in mm."""


def write_usd(rollout: Rollout, path: str | os.PathLike[str], envs: list[int] | None = None, stride: int = 1) -> Path:
    """Write a rollout as a USD stage; return the path.

    Args:
        rollout: what was recorded.
        path: ``.usdc`` or ``.usd`` (binary) or ``.usda`` (text); written whole or not at all.
        envs: environments; None: all.
        stride: write every stride-th frame only; time codes stay those of the rollout.

    Raises:
        RolloutError: another suffix, no such environment, a stride below 1, or a stage that does not fit into memory.
    """
    suffix = check_suffix("A USD file", path, (".usdc", ".usd", ".usda"), RolloutError)
    check_integer("stride", stride, 1, error=RolloutError)
    chosen = list(dict.fromkeys(rollout.check_envs(envs)))
    frames = list(range(0, rollout.num_frames, stride))

    # The stage is built in memory. At the peak, samples and what they are made from take 26 bytes a point and 10 a cell
    # in each frame.
    cells = sum(len(rollout.scene(env).cells) for env in chosen)
    points = sum(rollout.scene(env).num_points for env in chosen)
    needed = len(frames) * (26 * points + 10 * cells)
    free = free_memory("cpu")
    share = 0.9
    if free is not None and needed > share * free:
        least = math.ceil(stride * needed / int(share * free))
        raise RolloutError(
            f"A USD stage of {len(frames):,} frames needs about {needed / 2**30:.3g} GiB, and {free / 2**30:.3g} GiB"
            f" are free; write every {least}th frame (every={least}) or fewer environments."
        )

    # The stage and what it says of the rollout
    stage = Usd.Stage.CreateInMemory(f"rollout{suffix}")
    layer = stage.GetRootLayer()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(1 / FRAME_SECONDS)
    stage.SetFramesPerSecond(1 / FRAME_SECONDS)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(frames[-1])
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    for key, value in rollout.metadata.items():  # values that USD can hold
        if isinstance(value, str | bool | float) or (isinstance(value, int) and abs(value) < 2**31):
            name = Tf.MakeValidIdentifier(str(key))
            world.GetPrim().SetCustomDataByKey(f"warpvox:{name}", value)
    world.GetPrim().SetCustomDataByKey("warpvox:meanReturn", float(rollout.returns[-1, chosen].mean()))

    # Environments, in rows of eight, ten voxels between the largest of them
    materials = _define_materials(stage)
    step = _sizes(rollout, chosen).max(axis=0) + 10 * VOXEL
    row, column = np.divmod(np.arange(len(chosen)), 8)
    places = np.stack([column, -row], axis=1) * step  # [envs, 2]
    for env, place in zip(chosen, places, strict=True):
        # Values go straight to the layer: recomposing the stage after each of 64,000 would take minutes.
        _define_env(stage, rollout, env, place, materials)
        scene = rollout.scene(env)
        mesh = f"/World/env_{env:03d}/voxels"
        points = np.zeros((len(frames), scene.num_points, 3), np.float32)
        points[..., :2] = rollout.positions[frames, env, : scene.num_points]
        colours = colour_index(scene.cells, rollout.stretch(slice(None), env)[frames]).astype(np.int32)
        with Sdf.ChangeBlock():
            for number in _changes(points, interpolated=True):
                layer.SetTimeSample(f"{mesh}.points", float(frames[number]), _vec3(points[number]))
            for number in _changes(colours, interpolated=False):
                sample = Vt.IntArray.FromNumpy(colours[number])
                layer.SetTimeSample(f"{mesh}.primvars:displayColor:indices", float(frames[number]), sample)

    # Cameras and lights
    _define_cameras(stage, rollout, chosen, places, frames)
    sun = UsdLux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(2.0)
    UsdGeom.Xformable(sun).AddRotateXYZOp().Set(Gf.Vec3f(-35.0, 20.0, 0.0))
    UsdLux.DomeLight.Define(stage, "/World/sky").CreateIntensityAttr(0.6)

    with atomic_path(path, follow=True) as temporary:
        try:
            written = layer.Export(str(temporary))
            reason = "no reason is given"
        except Tf.ErrorException as error:
            written = False
            reason = str(error).rpartition("file: ")[2].split("'")[0]
        if not written:
            raise RolloutError(f"{path} cannot be written; is its disk full? USD says: {reason}.")
    return Path(path)


def _define_materials(stage: Any) -> dict[Cell, Any]:
    """Define a USD preview surface for every cell type."""
    UsdGeom.Scope.Define(stage, "/World/materials")
    materials = {}
    for cell in MATERIALS:
        path = f"/World/materials/{_material_name(cell)}"
        material = UsdShade.Material.Define(stage, path)
        surface = UsdShade.Shader.Define(stage, f"{path}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.7)
        diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        rest = Gf.Vec3f(*_linear(np.array(cell_colour(cell))).tolist())
        if cell in ACTUATORS:
            reader = UsdShade.Shader.Define(stage, f"{path}/colour")
            reader.CreateIdAttr("UsdPrimvarReader_float3")
            reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
            reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(rest)
            diffuse.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
        else:
            diffuse.Set(rest)
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
        materials[cell] = material
    return materials


def _material_name(cell: int) -> str:
    return MATERIALS[Cell(cell)].name.replace(" ", "_")


def _linear(colour: np.ndarray) -> np.ndarray:
    """Convert sRGB colours 0 to 255 to linear colours, float32."""
    value = colour / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _sizes(rollout: Rollout, envs: list[int]) -> np.ndarray:
    """Return width and height of the environments' worlds, float64 ``[envs, 2]``."""
    return np.array([[rollout.scene(env).width, rollout.scene(env).height] for env in envs]) * VOXEL


def _define_env(stage: Any, rollout: Rollout, env: int, place: np.ndarray, materials: dict[Cell, Any]) -> None:
    """Define the USD objects of one environment."""
    scene = rollout.scene(env)
    root = f"/World/env_{env:03d}"
    xform = UsdGeom.Xform.Define(stage, root)
    xform.AddTranslateOp().Set(Gf.Vec3d(*place.tolist(), 0.0))
    prim = xform.GetPrim()
    prim.SetCustomDataByKey("warpvox:return", float(rollout.returns[-1, env]))
    prim.SetCustomDataByKey("warpvox:length", int(rollout.lengths[env]))
    prim.SetCustomDataByKey("warpvox:design", int(rollout.design_index[env]))

    # What moves
    points = rollout.positions[:, env, : scene.num_points]
    low = points.min(axis=(0, 1))
    high = points.max(axis=(0, 1))
    # Top left, bottom left, bottom right, top right: counter-clockwise seen from +Z.
    quads = scene.corners[:, [0, 3, 2, 1]]
    mesh = _define_mesh(stage, f"{root}/voxels", quads, np.array([[*low, 0], [*high, 0]]))
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform).Set(_vec3(_linear(palette())))
    mesh.GetDisplayColorPrimvar().CreateIndicesAttr()

    # A GeomSubset with its material for each cell type that occurs
    binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    for cell in sorted(set(scene.cells.tolist())):
        faces = Vt.IntArray.FromNumpy(np.flatnonzero(scene.cells == cell).astype(np.int32))
        subset = binding.CreateMaterialBindSubset(_material_name(cell), faces, UsdGeom.Tokens.face)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[Cell(cell)])
    binding.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.partition)

    _define_terrain(stage, f"{root}/terrain", scene.terrain, materials[Cell.FIXED])


def _define_mesh(stage: Any, path: str, quads: np.ndarray, extent: np.ndarray) -> Any:
    """Define a USD Mesh of cells."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(quads), 4, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(quads.astype(np.int32).ravel()))
    mesh.CreateExtentAttr(_vec3(extent))
    mesh.CreatePointsAttr()
    return mesh


def _define_terrain(stage: Any, path: str, terrain: np.ndarray, material: Any) -> None:
    """Define one USD Mesh of all fixed cells; return it, or None if there are none."""
    if not terrain.any():
        return
    height, width = terrain.shape
    rows, columns = np.nonzero(terrain)

    # Nodes of the grid, row by row from the bottom, at the corners of cells: from top left counter-clockwise
    bottom_left = (height - rows - 1) * (width + 1) + columns
    top_left = bottom_left + width + 1
    nodes = np.stack([top_left, bottom_left, bottom_left + 1, top_left + 1], axis=1)
    used, quads = np.unique(nodes, return_inverse=True)

    # A little behind the voxels, against flicker where they touch
    y, x = np.divmod(used, width + 1)
    points = np.stack([x * VOXEL, y * VOXEL, np.full(len(used), -0.001)], axis=1).astype(np.float32)
    mesh = _define_mesh(stage, path, quads.reshape(-1, 4), np.array([points.min(axis=0), points.max(axis=0)]))
    mesh.GetPointsAttr().Set(_vec3(points))
    colour = _linear(np.array(cell_colour(Cell.FIXED)))
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(_vec3(colour[None]))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _changes(values: np.ndarray, interpolated: bool) -> list[int]:
    """Return the frames that differ from the frame before, which must be written.

    If values between samples are interpolated, also the frame before each change.
    """
    differs = (values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim)))
    moved = np.flatnonzero(differs) + 1
    return sorted({0, *moved.tolist(), *((moved - 1).tolist() if interpolated else [])})


def _define_cameras(stage: Any, rollout: Rollout, envs: list[int], places: np.ndarray, frames: list[int]) -> None:
    """Define a USD camera that follows the first environment's robot, and one that shows everything."""
    # The one that follows sees 14 voxels from bottom to top.
    height = 14 * VOXEL
    view = np.array([height * _APERTURE[0] / _APERTURE[1], height])
    corner = camera_path(rollout.scene(envs[0]), rollout.positions[:, envs[0]], tuple((view / VOXEL).tolist())) * VOXEL
    follow = _define_camera(stage, "/World/camera")
    distance = height * _FOCAL / _APERTURE[1]
    for frame in frames:
        x, y = (corner[frame] + view / 2 + places[0]).tolist()
        follow.Set(Gf.Vec3d(x, y, distance), float(frame))

    low = places.min(axis=0)
    high = (places + _sizes(rollout, envs)).max(axis=0)
    away = 1.1 * max((high[0] - low[0]) / _APERTURE[0], (high[1] - low[1]) / _APERTURE[1]) * _FOCAL
    middle = ((low + high) / 2).tolist()
    _define_camera(stage, "/World/overview").Set(Gf.Vec3d(*middle, away))


def _define_camera(stage: Any, path: str) -> Any:
    """Define a USD camera that looks along -Z; return its translation."""
    camera = UsdGeom.Camera.Define(stage, path)
    camera.CreateHorizontalApertureAttr(_APERTURE[0])
    camera.CreateVerticalApertureAttr(_APERTURE[1])
    camera.CreateFocalLengthAttr(_FOCAL)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 10000.0))
    return camera.AddTranslateOp()


def _vec3(values: np.ndarray) -> Any:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))
