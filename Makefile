# `make evaluate` and `make test` set everything up themselves, from nothing.

SUPPORTED := import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11; do \
  $$python -c "$(SUPPORTED)" 2>/dev/null && command -v $$python && break; done)
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
DEV    := $(VENV)/.dev
SITE   := $(VENV)/.site
# Without PYTHONWARNINGS each build of an editable package warns that it is one.
QUIET  := -m pip install --quiet --disable-pip-version-check
PIP    := PYTHONWARNINGS=ignore $(BIN)/python $(QUIET) --no-compile --constraint constraints.txt

# Modules are compiled when they are first imported, and kept: otherwise each process compiles
# scipy and pandas again, which takes it seconds.
unexport PYTHONDONTWRITEBYTECODE

.NOTPARALLEL: # two runs of pip in one environment break it

.PHONY: evaluate test test-wheel prove regress leaderboard check format bench schemas reference \
  pictures submission-tools clean

evaluate: $(READY)
	$(BIN)/minitouch-bench evaluate scripted --suite smoke --workers auto --fresh

test: $(DEV)
	$(BIN)/python -m pytest -n auto

prove: $(DEV)
	$(BIN)/python -m pytest -n auto -m slow --ignore tests/test_wheel.py

# The built wheel in an empty environment, by pip and, where it is installed, by uv.
test-wheel: $(DEV)
	$(BIN)/python -m pytest -n 0 -m slow tests/test_wheel.py

LEROBOT        := .venv-lerobot
LEROBOT_PIP    := PYTHONWARNINGS=ignore $(LEROBOT)/bin/python $(QUIET)
LEROBOT_PYTHON ?= $(shell for python in python3.12 python3.13 python3 \
  $(HOME)/.pyenv/versions/3.1[23].*/bin/python; do \
  $$python -c "import sys; sys.exit(sys.version_info[:2] not in ((3, 12), (3, 13)))" 2>/dev/null \
  && echo $$python && break; done)

.PHONY: test-lerobot
# LeRobot needs another Python and other versions, so an environment of its own.
test-lerobot:
	@if [ -z "$(LEROBOT_PYTHON)" ]; then \
	  echo "Skipped: LeRobot needs CPython 3.12 or 3.13, and there is none. With one elsewhere:" \
	    "make test-lerobot LEROBOT_PYTHON=/path/to/python3.12"; \
	else \
	  $(MAKE) --no-print-directory $(LEROBOT)/.ready && $(LEROBOT)/bin/python -m pytest \
	    -m 'slow or not slow' tests/policies/test_lerobot.py tests/libraries/test_lerobot.py; \
	fi

# The calibration policies against their committed baselines.
regress: $(READY)
	for policy in zero random open-loop scripted; do \
	  $(BIN)/minitouch-bench regress $$policy --baseline reports/baseline/$$policy \
	    --output build/regress/$$policy --fresh || exit 1; \
	done

leaderboard: $(READY)
	$(BIN)/minitouch-bench leaderboard build

.PHONY: site
# The documentation with the leaderboard, in site/: every dead link is an error. It opens offline.
site: $(SITE)
	@test -x $(BIN)/zensical || \
	  { echo "make site needs CPython 3.11.5 or later: make PYTHON=..." >&2; exit 1; }
	$(BIN)/zensical build --clean --strict
	cp -r reports/leaderboard site/leaderboard

check: $(DEV)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(DEV)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(DEV)
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.training

schemas: $(DEV)
	$(BIN)/python -m benchmarks.schemas

# The pages of docs/reference/ that follow from the code.
reference: $(DEV)
	$(BIN)/python -m benchmarks.reference

pictures: $(DEV)
	$(BIN)/python -m benchmarks.pictures

# What .github/workflows/submission.yml and play.yml need to run every format of policy.
submission-tools: $(READY)
	$(PIP) --editable '.[hub,onnx,sb3]'

clean:
	rm -rf $(VENV) $(LEROBOT) build dist site *.egg-info

# What evaluation needs. The build of torch for the CPU comes from PyTorch's own index: the usual one
# brings gigabytes of CUDA packages.
$(READY): pyproject.toml constraints.txt
	@if "$(PYTHON)" -c "$(SUPPORTED)" 2>/dev/null; then "$(PYTHON)" -m venv $(VENV); \
	elif [ -z "$(PYTHON)" ] && command -v uv >/dev/null; then \
	  uv venv --quiet --allow-existing --seed --python 'cpython>=3.11,<3.14' $(VENV); \
	else printf '%s\n' \
	  "MiniTouch-bench needs CPython 3.11, 3.12 or 3.13 with its module venv, not '$(PYTHON)'. Try one of:" \
	  "  uv:     pipx install uv; then make finds a Python or fetches one" \
	  "  pyenv:  pyenv install 3.13 && pyenv local 3.13" \
	  "  apt:    sudo apt install python3-venv, on Debian 12 or Ubuntu 24.04 and later" \
	  "  make PYTHON=/path/to/python3.13" >&2; exit 1; fi
	@echo "Installing MiniTouch-bench, PyTorch for the CPU, PyBullet and what they need into $(VENV):" \
	  "400 MB to download, 1.5 GB on the disk"
	@$(PIP) --retries 1 --no-deps --index-url https://download.pytorch.org/whl/cpu torch || \
	  echo "PyTorch's index of builds for the CPU cannot be reached: the usual build comes in its" \
	  "place, with 5.7 GB of CUDA packages"
	@$(PIP) --editable .
	@$(BIN)/python -m minitouch_bench.simulation.builds
	@touch $(READY)

# Every extra, and what tests and checks need.
$(DEV): $(READY)
	@echo "Installing every extra but lerobot and what the tests need into $(VENV): 800 MB more on the disk"
	@$(PIP) --editable '.[dev]'
	@touch $(DEV)

# The plugin is installed as a wheel, which is built aside: the build writes into its folder.
$(LEROBOT)/.ready: pyproject.toml $(wildcard integrations/lerobot/*)
	@echo "Installing LeRobot, PyTorch for the CPU and MiniTouch-bench into $(LEROBOT):" \
	  "2.5 GB on the disk"
	@"$(LEROBOT_PYTHON)" -m venv $(LEROBOT)
	@$(LEROBOT_PIP) --retries 1 --no-deps --index-url https://download.pytorch.org/whl/cpu \
	  'torch<2.12' 'torchvision<0.27' || \
	  echo "PyTorch's index of builds for the CPU cannot be reached: the usual build comes in its" \
	  "place, with 4 GB of CUDA packages"
	@$(LEROBOT_PIP) 'lerobot[training,evaluation,diffusion]==0.6.1' --editable . pytest pytest-timeout
	@rm -rf build/lerobot && mkdir -p build && cp -r integrations/lerobot build
	@$(LEROBOT_PIP) --no-deps ./build/lerobot
	@touch $@

$(SITE): $(READY)
	$(PIP) --editable '.[docs]'
	@touch $(SITE)
