PYTHON ?= python3
BIN = .venv/bin

.PHONY: demo test validate bench lint

demo: .venv/installed   ## the main job on the shipped data, ending in an HTML report
	$(BIN)/sim2real demo --out reports/demo

test: .venv/installed   ## lint and tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest

validate: .venv/installed   ## accuracy: known servos recovered, real servos fitted
	$(BIN)/python benchmarks/recovery.py
	$(BIN)/python benchmarks/real_servos.py

bench: .venv/installed   ## speed and memory, as ratios
	$(BIN)/python benchmarks/speed.py

lint: .venv/installed   ## format and fix what can be fixed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[report,ros,dev]'
	touch $@
