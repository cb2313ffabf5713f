# Each target works alone on a fresh clone with Python (3.11 or newer) and make.
PYTHON ?= python3
VENV := .venv
SCRIPTS := $(if $(filter Windows_NT,$(OS)),Scripts,bin)
BIN := $(VENV)/$(SCRIPTS)
UV := $(shell command -v uv 2>/dev/null)
DONE := $(VENV)/.installed

.PHONY: setup demo test test-slow test-most test-lowest lint docs wheel package bench clean

setup: $(DONE)

$(DONE): pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; v = sys.version_info[:2]; v < (3, 11) and sys.exit('flexspline needs Python 3.11 or newer, got %d.%d: make PYTHON=python3.12' % v)"
	$(PYTHON) -m venv $(VENV)
ifneq ($(UV),)
	$(UV) pip install --quiet --python $(BIN)/python --editable ".[dev]" --constraint constraints.txt
else
	$(BIN)/python -m pip install --quiet --upgrade pip
	PYTHONWARNINGS="ignore:Editable installation" $(BIN)/python -m pip install --quiet --editable ".[dev]" --constraint constraints.txt
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

# Of the fast tests of a file every eighth, with the lowest versions that pyproject.toml allows.
test-lowest:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/$(SCRIPTS)/python -m pip install --quiet uv
	.venv-lowest/$(SCRIPTS)/uv pip install --quiet --python .venv-lowest/$(SCRIPTS)/python --resolution lowest-direct --editable ".[test]"
	.venv-lowest/$(SCRIPTS)/python -m pytest -n auto --dist worksteal --every 8

lint: $(DONE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python .ci/words.py

docs: $(DONE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# Build a wheel and use it in an empty environment, away from the sources.
wheel: $(DONE)
	rm -rf build/wheel build/lib # setuptools would pack files that are no longer there
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/$(SCRIPTS)/python -m pip install --quiet build/wheel/*.whl --constraint constraints.txt
	cd build/wheel && venv/$(SCRIPTS)/flexspline --version
	cd build/wheel && venv/$(SCRIPTS)/flexspline run no_load --set duration=2 --set "filters=[RAREKF]" --no-figures
	cd build/wheel && venv/$(SCRIPTS)/flexspline report runs/no_load --json

# Build the source distribution, and a wheel from it, and check both for a package index.
package:
	rm -rf build/package build/lib
	$(PYTHON) -m venv build/package/venv
	build/package/venv/$(SCRIPTS)/python -m pip install --quiet build twine
	build/package/venv/$(SCRIPTS)/python -m build --outdir build/package/dist >build/package/log 2>&1 || { cat build/package/log; false; }
	build/package/venv/$(SCRIPTS)/python -m twine check --strict build/package/dist/*

bench: $(DONE)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) .venv-lowest build *.egg-info runs
	find . -name __pycache__ -prune -exec rm -rf {} +
