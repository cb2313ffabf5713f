"""Scenarios of an arm: YAML files in which a person states the motion of several joints in series."""

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
_BESIDE = (*_SHARED, "seed", "format")
"""Keys that stand beside `arm`, once for all joints."""


class JointInArm(Scenario):
    """A joint of an arm: what a scenario says of one, but for what all joints share. A disturbance is a torque on its link."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*$")]
    """In the arm; of its folder and, in the others' recordings, of the column of its angle."""
    length: Annotated[float, Field(gt=0, le=10, description="from its axis to the next one's, m")] = 0.4
    turn: Annotated[
        float,
        Field(ge=-math.pi, le=math.pi, description="of its axis about the link before it, against that one's, rad"),
    ] = 0.0

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Without what stands beside `arm`."""
        schema = handler(core_schema)
        own = handler.resolve_ref_schema(schema)
        for key in _BESIDE:
            own["properties"].pop(key, None)
        own["required"] = [key for key in own["required"] if key not in _BESIDE]
        return schema

    @model_validator(mode="after")
    def _in_an_arm(self) -> JointInArm:
        if self.locked_rotor:
            raise ValueError("locked_rotor: expected a joint that can move, got one whose rotor is held")
        for i, one in enumerate(self.disturbances):
            if one.lever != 0.0:
                raise ValueError(
                    f"disturbances.{i}.lever: expected 0, a torque alone (a force would load the joints before it by their "
                    f"own levers), got {one.lever:g} m"
                )
        return self


class ArmScenario(Strict):
    """An experiment with joints in series, from the base to the tip; with all angles at zero it hangs straight down."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Of the folder that holds the joints' runs."""
    description: str = ""
    """What it is for."""
    duration: Annotated[float, Field(gt=0, le=3600, description="s")]
    timestep: Annotated[float, Field(ge=1e-6, le=CONTROL_PERIOD, description="s")] = TIMESTEP
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of every random stream; each joint has streams of its own."""
    arm: Annotated[list[JointInArm], Field(min_length=1, max_length=12)]
    """Its joints, from the base to the tip."""

    @model_validator(mode="before")
    @classmethod
    def _shared(cls, given: Any) -> Any:
        """Hand every joint what is the same for all, and its seed."""
        if not isinstance(given, dict) or not isinstance(given.get("arm"), list):
            return given
        joints = []
        for i, one in enumerate(given["arm"]):
            if not isinstance(one, dict):
                return given
            for key in _BESIDE:
                if key in one:
                    raise ValueError(f"arm.{i}.{key}: expected it beside `arm`, for all joints, got it in one of them")
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
                raise ValueError(f"arm.{i}.name: expected a name of its own, got {name!r} again")
        for i, joint in enumerate(self.arm):
            if joint.disturbances and any(before.turn for before in self.arm[: i + 1]):
                raise ValueError(
                    f"arm.{i}.disturbances: expected none on a joint whose axis is turned, or stands on one that is (its torque "
                    "on the joints before it would depend on where they are)"
                )
        return self

    def with_joints(self, joints: Mapping[str, Joint]) -> ArmScenario:
        """The same with descriptions at hand, where its file has a name or a path: `arm.0.joint`, `arm.1.known_joint`."""
        arm = list(self.arm)
        for key, one in joints.items():
            _, place, name = key.split(".")
            arm[int(place)] = arm[int(place)].with_joints({name: one})
        return self.model_copy(update={"arm": arm})

    def written(self) -> dict[str, Any]:
        """As plain data, as a person would write it: what all joints share stands once."""
        data = self.model_dump(mode="json", exclude_none=True)
        for joint in data["arm"]:
            for key in _BESIDE:
                del joint[key]
        return data


def _seed(seed: int, name: str) -> int:
    """The seed of a joint: of the arm's and its name."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1)[0])


def load_any(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[Scenario | ArmScenario, Path]:
    """Load a scenario of a joint or of an arm: a file with `arm:` is one of an arm.

    Args:
      source, changes, seed: as of `scenario.load_scenario`; a joint's key in an arm is `arm.0.joint`, counted from the base.

    Returns:
      The scenario and its file.

    Raises:
      InputError: no such scenario, or one that is wrong; one line.
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
      InputError: no such scenario, one that is wrong, or that of a joint alone; one line.
    """
    data, path = read_scenario(source, None, seed, shipped_arms())
    put_all(data, changes or {}, str(path))
    if "arm" not in data:
        raise InputError(f"{path}: arm: expected a scenario of an arm, got that of a joint alone")
    return parse(data, ArmScenario, str(path) if changes else path), path.parent


def changed_arm(scenario: ArmScenario, changes: Mapping[str, Any], seed: int | None = None) -> ArmScenario:
    """A scenario of an arm with other values of dotted keys, and another seed where one is given.

    Raises:
      InputError: a key that leads nowhere, or a value that is wrong; one line.
    """
    where = f"scenario {scenario.name}"
    data = scenario.written() | ({} if seed is None else {"seed": seed})
    put_all(data, changes, where)
    given_joints = {f"arm.{i}.{key}": one for i, j in enumerate(scenario.arm) for key, one in j.given_joints.items()}
    return parse(data, ArmScenario, where).with_joints({k: one for k, one in given_joints.items() if k not in changes})
