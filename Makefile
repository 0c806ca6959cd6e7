PYTHON ?= python3
DEVICE ?= cpu
JOBS ?= auto
PIP_EXTRA ?=
BIN = .venv/bin
PIP = $(BIN)/pip install --quiet --constraint constraints.txt $(PIP_EXTRA)
# Compiled files are kept: each of the processes that tests start would else compile all of it anew
PYTEST = PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

.PHONY: demo test test-all docs validate bench yardstick

demo: .venv/demo   ## the main job on the shipped data, ending in an HTML report
	$(BIN)/sim2real demo --out reports/demo

test: .venv/installed   ## lint, types and tests, in as many processes as there are cores
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --num-workers $(JOBS)
	$(PYTEST) -m "not slow"

test-all: test   ## the slow tests too
	$(PYTEST) -m slow

docs: .venv/installed   ## the documentation, in build/site; a warning is an error
	$(PIP) --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

validate: .venv/installed   ## accuracy: known servos recovered, real ones fitted, published cases; DEVICE=cuda:0 for finer cells
	$(BIN)/python -m benchmarks.coverage --no-posterior
	$(BIN)/python -m benchmarks.real_servos --seeds 0 1 2 3
	$(BIN)/python -m benchmarks.validation --device $(DEVICE)

bench: .venv/installed   ## speed and memory, as ratios; first how fast the machine is
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.first_hour
	$(BIN)/python -m benchmarks.fluid_speed

yardstick: .venv/installed   ## what moved in the answers of the verbs since benchmarks/yardstick.json was written
	$(BIN)/python -m benchmarks.yardstick

# The demo needs neither tools of tests nor other simulators; the rest is installed beside it
.venv/demo: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(PIP) --editable '.[report,sim,rl]'
	touch $@

.venv/installed: .venv/demo
	$(PIP) --editable '.[ros,render,hardware,arviz,completion,dev]'
	touch $@

include reports/Makefile
