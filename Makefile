# `make evaluate` and `make test` set everything up themselves, from nothing.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

.PHONY: evaluate test prove regress leaderboard check format bench schemas tables pictures clean

evaluate: $(READY)
	$(BIN)/minitouch-bench evaluate scripted --suite smoke --fresh

test: $(READY)
	$(BIN)/python -m pytest -n auto

prove: $(READY)
	$(BIN)/python -m pytest -n auto -m slow

# The calibration policies against their committed baselines.
regress: $(READY)
	for policy in zero random open-loop scripted; do \
	  $(BIN)/minitouch-bench regress $$policy --baseline reports/baseline/$$policy \
	    --output build/regress/$$policy --fresh || exit 1; \
	done

leaderboard: $(READY)
	$(BIN)/minitouch-bench leaderboard build

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(READY)
	$(BIN)/python -m benchmarks.speed

schemas: $(READY)
	$(BIN)/python -m benchmarks.schemas

# The CSV files and report.md of each stored submission, which follow from its run.json.
tables: $(READY)
	$(BIN)/python -m benchmarks.stored_tables

pictures: $(READY)
	$(BIN)/python -m benchmarks.pictures

clean:
	rm -rf $(VENV) build dist *.egg-info

# The +cpu build of torch has no CUDA packages (gigabytes) behind it.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v == (3, 11) else \
	"MiniTouch-bench needs Python 3.11, the last that PyBullet has wheels for; this is %d.%d. Try: make PYTHON=/path/to/python3.11" % v)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $(READY)
