PYTHON ?= python3
BIN = .venv/bin

.PHONY: demo test validate validate-gpu bench lint

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
	$(BIN)/python benchmarks/real_diagnosis.py
	$(BIN)/sim2real validate

validate-gpu: .venv/installed   ## the fluid's published cases and resolution, on a GPU
	$(BIN)/sim2real validate --device cuda:0 --out reports/validation_gpu.html
	$(BIN)/python benchmarks/resolution.py --device cuda:0 --cells 0.02 0.01 0.005

bench: .venv/installed   ## speed and memory, as ratios
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/fluid_speed.py
	$(BIN)/python benchmarks/twin_speed.py

lint: .venv/installed   ## format and fix what can be fixed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[report,ros,sim,rl,hardware,dev]'
	touch $@
