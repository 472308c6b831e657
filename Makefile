PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: fly test lint fuzz clean

fly: $(STAMP)  ## install and fly the demo mission
	$(BIN)/aerialstar fly missions/demo.yaml

test: $(STAMP)  ## the whole test suite, one file at a time on each core
	$(BIN)/python -m pytest -n auto --dist loadfile

lint: $(STAMP)  ## style, types, import rule
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

FUZZ_S ?= 600

fuzz: $(STAMP)  ## throw made-up input at the simulated autopilot for FUZZ_S seconds; findings are written to fuzz/
	$(BIN)/pip install --quiet -e ".[fuzz]"
	mkdir -p fuzz/corpus
	$(BIN)/python -m tests.fuzz.fuzz_autopilot -max_total_time=$(FUZZ_S) -max_len=4096 -len_control=0 \
		-artifact_prefix=fuzz/ fuzz/corpus

# A torch that is already in the environment is kept: pip only adds what is missing.
$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -c "import torch" 2>/dev/null || $(BIN)/pip install --quiet -c constraints.txt torch
	$(BIN)/pip install --quiet -c constraints.txt -e ".[dev]"
	# For tests. Without its dependencies: its 3-D map would bring 750 MB of VTK and OpenCV.
	$(BIN)/pip install --quiet -c constraints.txt --no-deps MAVProxy
	touch $@

clean:
	rm -rf $(VENV) build *.egg-info
