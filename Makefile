# make demo: set up and measure four examples.  make test: set up and run the tests.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Tests of a file share simulations and processes, so that a file runs on one worker.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile

.PHONY: demo check test slow mutants build bench docs release

demo: $(VENV)/.runs
	$(BIN)/gauge demo

define lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy gauge_envs
	$(BIN)/lint-imports
endef

# What the pre-commit hooks run, in a minute.
check: $(VENV)/.installed
	$(lint)

test: $(VENV)/.installed
	$(lint)
	$(PYTEST)

# Slow checks train policies, simulate for long, or need packages that the other tests do without, as Drake.
slow: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[drake,ray,rl]"
	$(PYTEST) tests/backends -k drake
	$(PYTEST) -m slow

# Tests against 20 random changes of the package.
SEED ?= 1
mutants: $(VENV)/.installed
	$(BIN)/pip install --quiet "cosmic-ray>=8.7,<9"
	$(BIN)/python -m scripts.mutants --seed $(SEED)

# Generated pages: all of them, or those of NAME, as `make build NAME=cheat_sheet`.
build: $(VENV)/.installed
	$(BIN)/python -m scripts build $(NAME)

# Costs as ratios in one run, all of benchmarks/.
bench: $(VENV)/.installed
	$(BIN)/python benchmarks/table.py

# Archives, their contents, and the wheel on the lowest and the highest Python.
release: $(VENV)/.installed
	$(BIN)/pip install --quiet twine
	$(BIN)/python -m scripts release

docs: $(VENV)/.runs
	$(BIN)/pip install --quiet -e ".[docs]"
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build

# Running needs no engine but MuJoCo; the tests want them all.
$(VENV)/.runs: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -e ".[plot,sanity]"
	touch $@

$(VENV)/.installed: $(VENV)/.runs
	$(BIN)/pip install --quiet -e ".[dev]"
	touch $@
