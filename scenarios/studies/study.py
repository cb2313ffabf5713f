"""The schema of STUDY.yaml: scenarios, seeds, parameters and estimators."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from ...models import causes
from ...models.errors import InputError, check_each_once, nearest
from ...models.files import Strict, find, load, shown
from ..filters import FilterEntry, paper_entries, parameters_of

METRICS = (
    "rms", "max", "rms_to_sensor", "noise", "noise_ratio", "delay_ms", "response_ms", "missed",
    "robust_share", "mean_nis", "untrusted",
)  # fmt: skip
"""Metrics of an estimate, as in a run's `metrics.json`; `untrusted`: 1 if it is not to be trusted, else 0."""
COLUMNS = ("scenario", "cell", "run", "seed", "key", "cause", "filter", "failure")
"""Columns of the dataset, which are no names for axes."""
MOST_SEEDS = 10_000_000
_NAME = r"^[A-Za-z][A-Za-z0-9_]*$"

Value = float | str


class Axis(Strict):
    """A parameter that varies."""

    name: Annotated[str, Field(pattern=_NAME)]
    """Name of its column in the dataset."""
    label: str = ""
    """Name in figures, with unit."""

    @property
    def title(self) -> str:
        """Label, or else the name."""
        return self.label or self.name


class SettingAxis(Axis):
    """A dotted key of the scenario: `sensors.link_encoder.noise`, `plant.K2`, `mounting`, `controller.kp`.

    `filters.NAME.FIELD` varies a filter's tuning parameter, `filters.*.FIELD` that of every filter that has it. All these
    variants share one simulation.
    """

    kind: Literal["set"]
    key: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z0-9_*-]+)*$")]
    """Dotted key of the scenario, or `filters.NAME.FIELD`."""
    values: Annotated[list[Value], Field(min_length=1)]
    """Values of the key."""

    @property
    def of_filters(self) -> bool:
        """Whether it varies filters instead of the plant."""
        return self.key.startswith("filters.")

    @property
    def filter(self) -> str:
        """Name of the filter that it varies, `*` for all."""
        return self.key.split(".")[1]

    @property
    def parameter(self) -> str:
        """The parameter of filters that it varies, with dots."""
        return ".".join(self.key.split(".")[2:])


class ScaleAxis(Axis):
    """Several keys at once, each a number times the axis's value, such as the noise of all sensors."""

    kind: Literal["scale"]
    keys: Annotated[dict[str, float], Field(min_length=1)]
    """Dotted keys with their number at value 1."""
    values: Annotated[list[float], Field(min_length=1)]
    """Factors on these numbers."""


class LoadAxis(Axis):
    """Gravity moment [N·m] of the payload at horizontal, known to the estimators; the inertia changes in proportion."""

    kind: Literal["load"]
    name: Annotated[str, Field(pattern=_NAME)] = "load"
    values: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=1)]
    """Gravity moments [N·m]."""


class CauseAxis(Axis):
    """Causes of `models.causes`, hidden in the plant: parameters of ordinary size, drawn per seed, times each size.

    Draws at different sizes are multiples of each other. Size 0 is the joint without a cause.
    """

    kind: Literal["cause"]
    name: Annotated[str, Field(pattern=_NAME)] = "size"
    causes: Annotated[list[str], Field(min_length=1)]
    """Names (`flexspline causes`)."""
    sizes: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]
    """In ordinary sizes; 0 is the joint without a cause."""

    @model_validator(mode="after")
    def _known(self) -> CauseAxis:
        for i, name in enumerate(self.causes):
            if name not in causes.names():
                raise ValueError(
                    f"causes.{i}: expected the name of a known cause, got {name!r}{nearest(name, causes.names())}"
                )
        return self


class ToleranceAxis(Axis):
    """The plant's joint drawn within multiples of its tolerances, per seed; the estimators know the nominal numbers and their
    tolerances.

    Draws at different tolerances are multiples of each other, and every scenario has the same joints.
    """

    kind: Literal["tolerance"]
    name: Annotated[str, Field(pattern=_NAME)] = "tolerance"
    values: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)]
    """In the joint's tolerances."""
    zero_known: bool = True
    """Whether the link encoder's zero is known; otherwise it is drawn, too."""


AnyAxis = Annotated[SettingAxis | ScaleAxis | LoadAxis | CauseAxis | ToleranceAxis, Field(discriminator="kind")]


class Seeds(Strict):
    """`count` seeds from `first` on."""

    first: Annotated[int, Field(ge=0, lt=2**31)] = 1
    """First seed."""
    count: Annotated[int, Field(ge=1, le=MOST_SEEDS)]
    """Number of seeds."""


class ScenarioChoice(Strict):
    """A scenario with changes to dotted keys."""

    short: ClassVar[str] = "string"

    scenario: str
    """Name of a shipped scenario, or a path."""
    name: Annotated[str, Field(pattern=r"^([A-Za-z0-9][A-Za-z0-9_.-]*)?$")] = ""
    """Name in the study, if a scenario is used twice."""
    set: dict[str, Value | bool] = {}
    """Changes to dotted keys."""

    @model_validator(mode="before")
    @classmethod
    def _of_name(cls, data: Any) -> Any:
        return {"scenario": data} if isinstance(data, str) else data


class Study(Strict):
    """A sweep over all combinations of scenarios and values of axes, each with every seed."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name in figures and tables."""
    description: str = ""
    """Purpose."""
    seed: Annotated[int, Field(ge=0, lt=2**31, description="of the study; every run's streams derive from it")] = 1
    seeds: Seeds | Annotated[list[Annotated[int, Field(ge=0, lt=2**31)]], Field(min_length=1)]
    """A list, or `first` and `count`."""
    scenarios: Annotated[list[ScenarioChoice], Field(min_length=1)]
    """Names or paths, also with changes."""
    set: Annotated[dict[str, Value | bool], Field(description="changes to dotted keys of every scenario")] = {}
    vary: bool = False
    """Draw start, pace and pushes per seed, so that runs are independent."""
    axes: Annotated[list[AnyAxis], Field(max_length=6)] = []
    """Parameters that vary, in all combinations."""
    filters: list[FilterEntry] = Field(min_length=1, default_factory=paper_entries)
    """Estimators, as in a scenario."""
    metrics: Annotated[list[Literal[METRICS]], Field(min_length=1)] = list(METRICS)  # type: ignore[valid-type]
    """Metrics in the dataset."""
    reference: Annotated[str, Field(description="filter that the others are compared with")] = ""

    @model_validator(mode="after")
    def _consistent(self) -> Study:
        names = self.names
        check_each_once(names, "filters")
        if self.reference not in ("", *names):
            raise ValueError(
                f"reference: expected one of {names}, got {self.reference!r}{nearest(self.reference, names)}"
            )
        taken = [*COLUMNS, *METRICS]
        for i, axis in enumerate(self.axes):
            if axis.name in taken:
                raise ValueError(f"axes.{i}.name: expected a name that no other column has, got {axis.name!r}")
            taken.append(axis.name)
            values = axis.sizes if isinstance(axis, CauseAxis) else axis.values
            if len({str(v) for v in values}) < len(values) or len({isinstance(v, str) for v in values}) > 1:
                raise ValueError(f"axes.{i}: expected values of one kind, each once, got {shown(values)}")
            if isinstance(axis, SettingAxis) and axis.of_filters:
                self._check_parameter(i, axis)
        for kind in (CauseAxis, ToleranceAxis):
            if sum(isinstance(axis, kind) for axis in self.axes) > 1:
                name = next(axis.kind for axis in self.axes if isinstance(axis, kind))
                raise ValueError(f"axes: expected at most one of kind {name}, got more")
        if len(set(self.seed_list)) < len(self.seed_list):
            raise ValueError("seeds: expected every seed once, got one twice")
        return self

    def _check_parameter(self, i: int, axis: SettingAxis) -> None:
        if not axis.parameter:
            raise ValueError(f"axes.{i}.key: expected filters.NAME.FIELD, got {axis.key!r}")
        known = ["*", *self.names]
        if axis.filter not in known:
            raise ValueError(f"axes.{i}.key: expected one of {known}, got {axis.filter!r}{nearest(axis.filter, known)}")
        varying = [entry for entry in self.filters if varies(axis, entry)]
        if not varying:
            fields = {f for e in self.filters if axis.filter in ("*", e.name) for f in parameters_of(e.build())}
            raise ValueError(f"axes.{i}.key: {axis.filter} has no {axis.parameter!r}{nearest(axis.parameter, fields)}")
        for value in axis.values:
            for entry in varying:
                entry.varied(axis.parameter, value)

    @property
    def names(self) -> list[str]:
        """Names of the filters, in order."""
        return [f.name for f in self.filters]

    @property
    def compared_to(self) -> str:
        """The reference; by default RAREKF, or else the last filter."""
        return self.reference or ("RAREKF" if "RAREKF" in self.names else self.names[-1])

    @property
    def seed_list(self) -> range | list[int]:
        """The seeds in order."""
        s = self.seeds
        return range(s.first, s.first + s.count) if isinstance(s, Seeds) else s

    @property
    def plant_axes(self) -> list[AnyAxis]:
        """Axes that need another simulation."""
        return [a for a in self.axes if not (isinstance(a, SettingAxis) and a.of_filters)]

    @property
    def filter_axes(self) -> list[SettingAxis]:
        """Axes that only vary filters."""
        return [a for a in self.axes if isinstance(a, SettingAxis) and a.of_filters]

    def with_seeds(self, count: int) -> Study:
        """Return the study with `count` seeds; at most those that it lists."""
        if isinstance(self.seeds, Seeds):
            if count > MOST_SEEDS:
                raise InputError(f"--seeds: expected at most {MOST_SEEDS}, got {count}")
            return self.model_copy(update={"seeds": Seeds(first=self.seeds.first, count=count)})
        if count > len(self.seeds):
            raise InputError(f"--seeds: expected at most {len(self.seeds)}, as many as the study lists, got {count}")
        return self.model_copy(update={"seeds": self.seeds[:count]})


def varies(axis: SettingAxis, entry: FilterEntry) -> bool:
    """Return whether an axis varies a filter."""
    return axis.filter in ("*", entry.name) and axis.parameter in parameters_of(entry.build())


def points(axis: AnyAxis) -> list[dict[str, Value]]:
    """Return the columns of an axis at each of its points; a cause axis has two columns."""
    if isinstance(axis, CauseAxis):
        none: list[dict[str, Value]] = [{"cause": "none", axis.name: 0.0}] if 0.0 in axis.sizes else []
        sizes = [s for s in axis.sizes if s != 0.0]
        return none + [{"cause": c, axis.name: s} for c, s in itertools.product(axis.causes, sizes)]
    return [{axis.name: value} for value in axis.values]


def shipped_studies() -> dict[str, Path]:
    """Return the studies that the package ships, by name."""
    return {path.stem: path for path in sorted(Path(__file__).parent.glob("*.yaml"))}


def load_study(source: str | Path) -> tuple[Study, Path]:
    """Load a shipped study by its name, or a YAML file; return it with the folder of its file. Raises `InputError`: an
    unknown or wrong study."""
    path = find(source, shipped_studies(), "study")
    return load(path, Study, "a study"), path.parent
