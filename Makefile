# make demo: set up and run the main job.  make test: set up and run the tests.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

DEMO := "SlopeSlider-*" "Turntable-1-*" BouncingBall-rubber NewtonsCradle-metal Pendulum-metal

.PHONY: demo test slow lint bench docs clean

demo: $(VENV)/.runs
	$(BIN)/gauge run $(DEMO) --out results
	$(BIN)/gauge run BouncingBall-rubber NewtonsCradle-metal --parameters effective --out results
	$(BIN)/gauge plot results --out plots

test: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy gauge_envs
	$(BIN)/python -m pytest -n 2

# Some slow checks train policies.
slow: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[rl]"
	$(BIN)/python -m pytest -n 2 -m slow

bench: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[bench]"
	$(BIN)/python benchmarks/step.py
	$(BIN)/python benchmarks/dtw.py

docs: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[docs]"
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build

# Running needs no engine but MuJoCo; the tests want them all.
$(VENV)/.runs: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -e ".[plot]"
	touch $@

$(VENV)/.installed: $(VENV)/.runs
	$(BIN)/pip install --quiet -e ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) results plots
