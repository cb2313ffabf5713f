"""Scenarios of an arm: YAML files that describe the motion of several joints in series."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from ...models.errors import InputError
from ...models.files import Strict, parse
from ...models.joint import Joint
from ...sim.loop import CONTROL_PERIOD
from ...sim.plant import TIMESTEP
from ..scenario import Scenario, parse_changed, put_all, read_scenario, shipped_arms

_SHARED = ("duration", "timestep")
_COMMON = (*_SHARED, "seed", "format")
"""Keys next to `arm`, for all joints."""


class JointInArm(Scenario):
    """A joint of an arm: a scenario without the common keys. A disturbance is a torque on its link."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*$")]
    """Name in the arm, of its folder, and of the column of its angle in the others' recordings."""
    length: Annotated[float, Field(gt=0, le=10, description="from its axis to the next axis, m")] = 0.4
    turn: Annotated[
        float,
        Field(
            ge=-math.pi,
            le=math.pi,
            description="turn of its axis about the link before it, relative to the axis before, rad",
        ),
    ] = 0.0

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema without the common keys."""
        schema = handler(core_schema)
        own = handler.resolve_ref_schema(schema)
        for key in _COMMON:
            own["properties"].pop(key, None)
        own["required"] = [key for key in own["required"] if key not in _COMMON]
        return schema

    @model_validator(mode="after")
    def _in_an_arm(self) -> JointInArm:
        if self.locked_rotor:
            raise ValueError("locked_rotor: expected a joint that can move, got one whose rotor is held")
        if self.payloads:
            raise ValueError("payloads: expected none on a joint of an arm (they would also load the joints before it)")
        for i, one in enumerate(self.disturbances):
            if one.lever != 0.0:
                raise ValueError(
                    f"disturbances.{i}.lever: expected 0, a pure torque (a force would also load the joints before it), "
                    f"got {one.lever:g} m"
                )
        return self


class ArmScenario(Strict):
    """An experiment with joints in series, from the base to the tip; with all angles zero it points straight down."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name of the folder with the joints' runs."""
    description: str = ""
    """Purpose."""
    duration: Annotated[float, Field(gt=0, le=3600, description="s")]
    timestep: Annotated[float, Field(ge=1e-6, le=CONTROL_PERIOD, description="s")] = TIMESTEP
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of every random stream; joints have different streams."""
    arm: Annotated[list[JointInArm], Field(min_length=1, max_length=12)]
    """Joints, from the base to the tip."""

    @model_validator(mode="before")
    @classmethod
    def _shared(cls, given: Any) -> Any:
        """Give every joint the common keys and its seed."""
        if not isinstance(given, dict) or not isinstance(given.get("arm"), list):
            return given
        joints = []
        for i, one in enumerate(given["arm"]):
            if not isinstance(one, dict):
                return given
            for key in _COMMON:
                if key in one:
                    raise ValueError(f"arm.{i}.{key}: expected it next to `arm`, for all joints, got it in one of them")
            shared = {key: given[key] for key in _SHARED if key in given}
            seed = given.get("seed", 1)
            if isinstance(seed, int) and seed >= 0:
                shared["seed"] = _seed(seed, str(one.get("name", "")))
            pushes = one.get("disturbances")
            if isinstance(pushes, list):
                shared["disturbances"] = [{"lever": 0.0} | d if isinstance(d, dict) else d for d in pushes]
            joints.append(one | shared)
        return given | {"arm": joints}

    @model_validator(mode="after")
    def _named_once(self) -> ArmScenario:
        names = [joint.name for joint in self.arm]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"arm.{i}.name: expected another name, got {name!r} again")
        for i, joint in enumerate(self.arm):
            if joint.disturbances and any(before.turn for before in self.arm[: i + 1]):
                raise ValueError(
                    f"arm.{i}.disturbances: expected none on a joint whose axis, or one before it, is turned (its torque on the "
                    "joints before it would depend on their angles)"
                )
        return self

    def with_joints(self, joints: Mapping[str, Joint]) -> ArmScenario:
        """Return the scenario with `Joint` objects in place of names or paths: `arm.0.joint`, `arm.1.known_joint`."""
        arm = list(self.arm)
        for key, one in joints.items():
            _, place, name = key.split(".")
            arm[int(place)] = arm[int(place)].with_joints({name: one})
        return self.model_copy(update={"arm": arm})

    def written(self, stated: bool = False) -> dict[str, Any]:
        """Return plain data, as in a file, with the common keys once; `stated`: without defaults."""
        data = self.model_dump(mode="json", exclude_none=True, exclude_unset=stated)
        for joint in data["arm"]:
            for key in _COMMON:
                joint.pop(key, None)
        return data


def _seed(seed: int, name: str) -> int:
    """Return the seed of a joint, from the arm's seed and its name."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1)[0])


def load_any(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[Scenario | ArmScenario, Path]:
    """Load a scenario of a joint or, with the key `arm:`, of an arm.

    Args:
      source, changes, seed: as of `scenario.load_scenario`; keys of an arm's joints are `arm.0.joint`, counted from the base.

    Returns:
      The scenario and its file.

    Raises:
      InputError: an unknown or wrong scenario.
    """
    data, path = read_scenario(source, changes, seed, shipped_arms())
    if "arm" in data:
        return parse_changed(data, ArmScenario, path, changes), path
    return parse_changed(data, Scenario, path, changes), path


def load_arm(
    source: str | Path, seed: int | None = None, changes: Mapping[str, Any] | None = None
) -> tuple[ArmScenario, Path]:
    """Load a scenario of an arm, with other values of dotted keys.

    Raises:
      InputError: an unknown or wrong scenario, or that of a single joint.
    """
    data, path = read_scenario(source, None, seed, shipped_arms())
    put_all(data, changes or {}, str(path))
    if "arm" not in data:
        raise InputError(f"{path}: arm: expected a scenario of an arm, got that of a single joint")
    return parse(data, ArmScenario, str(path) if changes else path), path.parent


def changed_arm(scenario: ArmScenario, changes: Mapping[str, Any], seed: int | None = None) -> ArmScenario:
    """Return a scenario of an arm with other values of dotted keys, and another seed if given.

    Raises:
      InputError: an unknown key or a wrong value.
    """
    where = f"scenario {scenario.name}"
    data = scenario.written(stated=True) | ({} if seed is None else {"seed": seed})
    put_all(data, changes, where)
    given_joints = {f"arm.{i}.{key}": one for i, j in enumerate(scenario.arm) for key, one in j.given_joints.items()}
    return parse(data, ArmScenario, where).with_joints({k: one for k, one in given_joints.items() if k not in changes})
