PYTHON ?= python3
BIN := .venv/bin
DEMO := out/demo
INPUT := examples/data/sports2d_demo.npz

.PHONY: demo test lint clean

demo: .venv/ready  ## denoise what a pose estimator saw in a video, and plot it
	$(BIN)/python examples/denoise.py $(INPUT) --output $(DEMO)/sports2d_demo.bvh --config configs/bilateral.yaml --overwrite
	$(BIN)/python examples/plot_motion.py $(INPUT) $(DEMO)/sports2d_demo.bvh --output $(DEMO)/arm.png --joint LeftForeArm --start 6
	$(BIN)/python examples/plot_motion.py $(INPUT) $(DEMO)/sports2d_demo.bvh --output $(DEMO)/leg.png --joint RightLeg --start 190

test: .venv/ready  ## all tests but the slow ones
	$(BIN)/python -m pytest -q -n auto

lint: .venv/ready  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q -c constraints.txt -e '.[dev]'
	touch $@

clean:
	rm -rf .venv out
