# make figures   every notebook's figures, from cached artifacts where there are any
# make test      ruff, pytest and all notebooks at the smoke preset
# make lint      ruff and types
#
# Options of make figures: PRESET=smoke|laptop|thesis  ONLY=01,05  RECOMPUTE=all|expert,data  JOBS=2
#   SNAKEMAKE="--executor slurm"   further arguments for Snakemake
# Options of make test: WORKERS=2   processes that the tests are shared between
# Options of the set-up: PYTHON=python3.12  TORCH_INDEX=<address>   index with CPU builds of torch

PRESET ?= laptop
ONLY ?=
RECOMPUTE ?=
JOBS ?= 1
SNAKEMAKE ?=
WORKERS ?= 2
PYTHON ?= python3
TORCH_INDEX ?=

VENV := .venv
BIN := $(VENV)/bin
LOCK_HASH := $(shell $(PYTHON) -c "import hashlib; print(hashlib.sha256(open('environment.lock','rb').read()).hexdigest()[:12])")
STAMP := $(VENV)/.installed-$(LOCK_HASH)

# A Linux machine without a screen draws through EGL.  Where that library is missing the variable
# must stay unset: MuJoCo could not even be imported.
ifeq ($(shell uname -s)$(DISPLAY),Linux)
ifneq ($(shell $(PYTHON) -c "import ctypes.util; print(ctypes.util.find_library('EGL') or '')"),)
export MUJOCO_GL ?= egl
endif
endif

.PHONY: figures test setup lint gallery clean

figures: $(STAMP)
	@$(BIN)/python -m cassie_lib.batch figures --preset "$(PRESET)" --only "$(ONLY)" --recompute "$(RECOMPUTE)" --jobs "$(JOBS)" -- $(SNAKEMAKE)

# The notebooks check themselves; nbval cannot inject a preset, hence the variable.
test: export OMP_NUM_THREADS ?= 1
test: export OPENBLAS_NUM_THREADS ?= 1
test: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q -n $(WORKERS) --cov --cov-report=term:skip-covered tests
	CASSIE_PRESET=smoke $(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile -p no:cacheprovider --nbval-lax --nbval-current-env notebooks

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

setup: $(STAMP)

$(STAMP): environment.lock
	@$(PYTHON) -c "import sys; sys.exit('cassie_lib needs Python 3.11 or newer, this is ' + sys.version.split()[0] + ': choose one with PYTHON=python3.11') if sys.version_info < (3, 11) else None"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) -r environment.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	rm -f $(VENV)/.installed-*
	touch $@

gallery: $(STAMP)
	@$(BIN)/python -m cassie_lib.gallery --preset "$(PRESET)"

# Removes what is regenerated; kept artifacts, committed figures and the environment stay.
clean:
	rm -rf data/cache .snakemake .pytest_cache .ruff_cache .mypy_cache .coverage
