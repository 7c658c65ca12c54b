# Needs python 3.11 or newer with venv, and nothing else: the rest is installed into .venv, which the stamps remember.
SHELL := /bin/bash
.DELETE_ON_ERROR:

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
OUT ?= out
export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: run test check docs figures wheel clean

run: .venv/.program
	$(BIN)/trueroll batch sample_videos -o $(OUT)
	@echo "Look at $(OUT)/*/slow.mp4, $(OUT)/*/report.html and $(OUT)/summary.csv; or: $(BIN)/trueroll view $(OUT)/overhead_pool"

test: .venv/.tools
	$(BIN)/python -m pytest -n auto --dist worksteal $(ARGS)

check: .venv/.tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest tests/test_layering.py tests/test_names.py

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "Look at site/index.html; or, with full-text search: $(BIN)/mkdocs serve"

figures: .venv/.tools
	$(BIN)/python -m benchmarks.update_figures $(ARGS)

wheel: .venv/.tools
	.ci/check_wheel

clean:
	rm -rf .venv out site build *.egg-info

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "python 3.11 or newer is needed and was not found; install it (Debian: apt-get install python3 python3-venv)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "python 3.11 or newer is needed; $$($(PYTHON) --version) was found; name another with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "python's venv module is needed and was not found; install it (Debian: apt-get install python3-venv)" >&2; exit 1; }
	$(PYTHON) -m venv .venv

# torch first and capped: its newest builds bring gigabytes of CUDA.
.venv/.program: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet "torch>=2.6,<=2.13.0"
	$(BIN)/python -m pip install --quiet -e .
	@echo "The first clip compiles numerical code for this machine, once: it takes one to two minutes more."
	@touch $@

.venv/.tools: .venv/.program
	$(BIN)/python -m pip install --quiet -e ".[dev,check,train]"
	@touch $@

.venv/.docs: .venv/.program
	$(BIN)/python -m pip install --quiet -e ".[docs]"
	@touch $@
