# Each target works alone on a fresh clone with Python (3.11 or newer) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(shell command -v uv 2>/dev/null)
DONE := $(VENV)/.installed

.PHONY: setup demo test test-slow test-most test-lowest lint docs wheel bench clean

setup: $(DONE)

$(DONE): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
ifneq ($(UV),)
	$(UV) pip install --quiet --python $(BIN)/python --editable ".[dev]" --constraint constraints.txt
else
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[dev]" --constraint constraints.txt
endif
	touch $@

demo: $(DONE)
	$(BIN)/flexspline compare --out runs
	$(BIN)/flexspline challenge --hidden one --seed 3 --measurement runs/hidden

test: $(DONE)
	$(BIN)/python -m pytest -n auto --dist worksteal

test-slow: $(DONE)
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow

# Slow tests that fit into minutes: without most whole diagnoses, an hour's recording, and further cases of what `make test` runs.
test-most: $(DONE)
	$(BIN)/python -m pytest -n auto --dist worksteal -m "slow and not long"

# Fast tests, of their parameters every eighth, with the lowest versions that pyproject.toml allows.
test-lowest:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet uv
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct --editable ".[test]"
	.venv-lowest/bin/python -m pytest -n auto --dist worksteal --every 8

lint: $(DONE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python .ci/words.py

docs: $(DONE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# Build a wheel and use it in an empty environment, away from the sources.
wheel: $(DONE)
	rm -rf build/wheel
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/bin/python -m pip install --quiet build/wheel/*.whl --constraint constraints.txt
	cd build/wheel && venv/bin/flexspline --version
	cd build/wheel && venv/bin/flexspline run no_load --set duration=2 --set "filters=[RAREKF]" --no-figures
	cd build/wheel && venv/bin/flexspline report runs/no_load --json

bench: $(DONE)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) .venv-lowest build *.egg-info runs
	find . -name __pycache__ -prune -exec rm -rf {} +
