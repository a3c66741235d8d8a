# make demo: set up and run the main job.  make test: set up and run the tests.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Tests of a file share simulations and processes, so that a file runs on one worker.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile

DEMO := "SlopeSlider-*" "Turntable-1-*" BouncingBall-rubber NewtonsCradle-metal Pendulum-metal

# What a change is checked with before it is committed.
CHECK_TESTS := tests/test_dependencies.py tests/test_layers.py tests/evaluation tests/experiments/test_task_files.py \
	tests/experiments/test_task_rigid.py tests/observables tests/references tests/scene/test_drivers.py

# What every supported version of Python is tested with.
MATRIX := 3.12:lowest 3.13:newest
MATRIX_TESTS := tests/backends/mujoco/test_mujoco_laws.py tests/cli tests/envs/test_env.py tests/evaluation \
	tests/experiments/test_scene_source.py tests/experiments/test_task_files.py tests/experiments/test_task_rigid.py \
	tests/experiments/test_user_file.py tests/observables tests/references tests/runs tests/scene tests/test_notebooks.py

# Those of rigid scenes, which also pass with the oldest MuJoCo.
RIGID_TESTS := tests/backends/mujoco/test_mujoco_versions.py tests/tools/sanity/test_sanity_probe.py

.PHONY: demo test check lint slow test-engines test-genesis test-matrix attack mutants bench size gallery docs clean

demo: $(VENV)/.runs
	$(BIN)/gauge run $(DEMO) --out results
	$(BIN)/gauge run BouncingBall-rubber NewtonsCradle-metal --parameters effective --out results
	$(BIN)/gauge plot results --out plots

test: lint
	$(PYTEST)

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy gauge_envs
	$(BIN)/lint-imports

# Under a minute: what the pre-commit hooks run, and the tests that fail most often.
check: lint
	$(PYTEST) $(CHECK_TESTS)

# Some slow checks train policies, or need packages that the other tests do without.
slow: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[onnx,ray,rerun,rl,slurm]"
	$(PYTEST) -m slow

# Engines that the other tests do without, because they are large, and the slow checks of all engines.
test-engines: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[drake]"
	$(PYTEST) tests/backends -k drake
	$(PYTEST) -m slow tests/backends

# Genesis, in an environment of its own: PyTorch is large. Its kernels take minutes to compile and stay in this folder.
test-genesis: $(VENV)-genesis/.installed
	QD_OFFLINE_CACHE_FILE_PATH=$(CURDIR)/$(VENV)-genesis/kernels \
		$(VENV)-genesis/bin/python -m pytest tests/backends/genesis tests/backends/test_contract.py \
		tests/backends/test_refusals.py -k "genesis and not test_worlds"

# The built wheel on other versions of Python, and the guides' commands as a reader installs and runs them.
test-matrix: $(VENV)/.installed
	$(BIN)/python scripts/test_matrix.py $(MATRIX) --tests $(MATRIX_TESTS) --rigid-tests $(RIGID_TESTS)
	$(BIN)/python -m pytest -m slow tests/test_install_commands.py -k "(README or getting_started or scripts) and not point_engine"

# Damaged files for all parsers, for 20 minutes of processor time; the next call goes on where this one ended.
attack: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[onnx,rerun]"
	$(BIN)/python studies/robustness/attack.py --state $(VENV)/attack

# Small faults in the core, and the share that the tests notice: hours of processor time; an interrupted call goes on.
mutants: $(VENV)/.installed
	$(BIN)/python scripts/mutants.py run --seed $(or $(SEED),1)

# Costs as ratios in one run, all of benchmarks/.
bench: $(VENV)/.installed
	$(BIN)/pip install --quiet -e ".[bench]"
	$(BIN)/python benchmarks/table.py
	$(BIN)/python benchmarks/import_memory.py --trials 100

# Tokens of each room, and how dense its lines are; nothing tests them.
size:
	$(PYTHON) scripts/size.py

# Pictures and films of docs/gallery.md. The results stay, so that a second time draws alone.
gallery: $(VENV)/.installed
	$(BIN)/python scripts/build_gallery.py

docs: $(VENV)/.runs
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

# A requirement of PyTorch without a version may install gigabytes for graphics cards.
$(VENV)-genesis/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-genesis
	$(VENV)-genesis/bin/pip install --quiet torch==2.13.0
	$(VENV)-genesis/bin/pip install --quiet -e ".[genesis]" "pytest>=8.0"
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-genesis results plots
