# make demo   fly one simulated UAV 30 m through pillars and write the flight's report
# make test   lint, type check and run every test
#
# Both set up all they need in .venv and touch nothing else.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
DEMO := runs/demo

export PYTHONDONTWRITEBYTECODE :=
export NUMBA_THREADING_LAYER := omp

.PHONY: demo test lint kernels
demo: $(INSTALLED)
	$(BIN)/companion warmup
	$(BIN)/sitl run field_configs/sitl_leader_pillars.yaml --out $(DEMO)
	$(BIN)/companion report $(DEMO)/flight.mcap --output $(DEMO)/report.html

test: $(INSTALLED)
	$(MAKE) --jobs=2 lint kernels
	$(BIN)/pytest -q -n 2 -m "not sockets"
	$(BIN)/pytest -q -m sockets

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

kernels: $(INSTALLED)
	$(BIN)/companion warmup
	$(BIN)/python -c 'from sitl.campaign.scenes import prepare; prepare()'

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "Python 3.10 or newer is needed; name it with: make PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
		{ echo "The venv module is missing; install it with: apt-get install python3-venv"; exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@
