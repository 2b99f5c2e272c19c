"""A rope to climb, hanging from a beam: a one-dimensional flex that MuJoCo simulates.

It is a discrete elastic rod: points that can move freely, a little stiffness against bending, and
an equality on every edge that keeps its length. So it swings and bends like a gymnasium's rope, and
hangs straight and still when left alone.
"""

from __future__ import annotations

import math

import mujoco

from mjmotion.boundary.limits import MOST_SCENE_PARTS, at_most
from mjmotion.exceptions import SceneError
from mjmotion.scene.stage import FLOOR, WOOD, add_start, check_positive, new_scene

ROPE = "rope"
"""Name of the flex, and beginning of the names of its points: ``rope1`` is next to the beam."""
HEMP = "hemp"
"""Material of the rope."""

RADIUS = 0.018  # of a gymnasium's rope [m]
BEAM = 4.3  # height that it hangs from [m]
LENGTH = 4.0  # [m]

EDGE = 0.05  # between two of its points [m]
_DENSITY = 800.0  # of hemp with air in it [kg/m³]
_BENDING = 0.05  # torque over curvature [N m²]
_BENDING_DAMPING = 0.02  # [s]
# Air as thick as syrup takes the place of the friction in a beam's hook: a swing halves in 3 s.
_VISCOSITY = 0.05  # [Pa s]
_STEP = 0.002  # [s]
_EDGE_STIFF = (-3e5, -300.0)  # solref of the edges' equality: 1 N/kg stretches an edge by 3 µm
_EDGE_IMPEDANCE = (0.99, 0.999, 0.001, 0.5, 2.0)
_THICK = 0.1  # of the beam and its posts [m]
_SPAN = 3.0  # from the rope to either post [m]


def rope(
    *, beam: float = BEAM, length: float = LENGTH, radius: float = RADIUS, edge: float = EDGE
) -> mujoco.MjSpec:
    """Return a rope that hangs from a beam over a level floor, at x = y = 0.

    Args:
      beam: height that the rope hangs from [m].
      length: of the rope [m]; less than ``beam``.
      radius: of the rope [m].
      edge: distance of the points that it is made of [m], about.

    Raises:
      SceneError: a size is not positive, or the rope lies on the floor.
    """
    check_positive("rope", beam=beam, length=length, radius=radius, edge=edge)
    if length >= beam:
        raise SceneError(f"rope: length is {length:g} m, it must be less than the beam's {beam:g}")
    if not radius <= edge <= length / 3:
        raise SceneError(f"rope: edge is {edge:g} m: give {radius:g} to {length / 3:g}")
    at_most(length / edge, MOST_SCENE_PARTS, "rope: points", SceneError)
    spec = new_scene("rope", center=(0.0, 0.0), radius=6.0)
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 0.05), material=FLOOR
    )
    add_start(spec)
    _add_frame(spec, beam)
    _add_flex(spec, beam, length, radius, round(length / edge))
    spec.option.viscosity = _VISCOSITY
    spec.option.timestep = _STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    return spec


def _add_frame(spec: mujoco.MjSpec, beam: float) -> None:
    """Add the beam that the rope hangs from, on two posts."""
    box, half = mujoco.mjtGeom.mjGEOM_BOX, _THICK / 2.0
    top = beam + half
    spec.worldbody.add_geom(
        name="beam",
        type=box,
        size=(half, _SPAN + half, half),
        pos=(0.0, 0.0, top),
        material=WOOD,
        contype=0,  # the rope begins in it
        conaffinity=0,
    )
    for name, y in (("left_post", _SPAN), ("right_post", -_SPAN)):
        spec.worldbody.add_geom(
            name=name, type=box, size=(half, half, beam / 2), pos=(0.0, y, beam / 2), material=WOOD
        )


def _add_flex(spec: mujoco.MjSpec, beam: float, length: float, radius: float, count: int) -> None:
    """Add ``count`` points below the beam, each free along three slides, and the flex of them."""
    spec.add_material(name=HEMP, rgba=(0.72, 0.60, 0.40, 1.0), specular=0.05, shininess=0.05)
    edge = length / count
    mass = _DENSITY * math.pi * radius**2 * edge
    bodies = ["world"]
    for number in range(1, count + 1):
        share = mass if number < count else 0.5 * mass
        body = spec.worldbody.add_body(
            name=f"{ROPE}{number}",
            pos=(0.0, 0.0, beam - edge * number),
            mass=share,
            inertia=(share * edge**2 / 12,) * 3,
            # MuJoCo writes no pos that is zero, and reads no inertial without one.
            ipos=(0.0, 0.0, 1e-9),
            explicitinertial=True,
        )
        for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
            body.add_joint(
                name=f"{ROPE}{number}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis
            )
        bodies.append(body.name)
    flex = spec.add_flex(name=ROPE, dim=1, radius=radius, material=[HEMP])
    flex.vertbody = bodies
    flex.vert = [0.0, 0.0, beam] + [0.0] * (3 * count)
    flex.elem = [point for first in range(count) for point in (first, first + 1)]
    flex.young = _BENDING / (math.pi * radius**4 / 4.0)
    flex.damping = _BENDING_DAMPING
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
    spec.add_equality(
        name=ROPE,
        type=mujoco.mjtEq.mjEQ_FLEX,
        name1=ROPE,
        solref=_EDGE_STIFF,
        solimp=_EDGE_IMPEDANCE,
    )
