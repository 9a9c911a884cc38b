# `make evaluate` and `make test` set everything up themselves, from nothing.

PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

.PHONY: evaluate test prove check format bench pictures clean

evaluate: $(READY)
	$(BIN)/minitouch-bench evaluate scripted --suite smoke --fresh

test: $(READY)
	$(BIN)/python -m pytest -n auto

prove: $(READY)
	$(BIN)/python -m pytest -n auto -m slow

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(READY)
	$(BIN)/python -m benchmarks.speed

pictures: $(READY)
	$(BIN)/python -m benchmarks.pictures

clean:
	rm -rf $(VENV) build dist *.egg-info

# The +cpu build of torch has no CUDA packages (gigabytes) behind it.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info < (3, 13) else \
	"MiniTouch-bench needs Python 3.11 (or 3.12, where PyBullet is compiled for minutes); this is %d.%d. Try: make PYTHON=/path/to/python3.11" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $(READY)
