# Needs python 3.11 or newer with venv, and nothing else: the rest is installed into .venv, which the stamps remember.
SHELL := /bin/bash
.DELETE_ON_ERROR:

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
OUT ?= out
export OMP_NUM_THREADS ?= 1
KERNELS ?= Haswell Nehalem
NUMERICAL_TESTS := tests/models/numerics tests/models/estimation tests/diagnosis tests/pipeline/test_degenerate_tracks.py

.PHONY: run app test test-kernels check mutants figures docs notebooks wheel clean

run: .venv/.program
	$(BIN)/trueroll batch sample_videos -o $(OUT) --jobs 2
	@echo "Look at $(OUT)/*/slow.mp4, $(OUT)/*/report.html and $(OUT)/summary.csv; or: $(BIN)/trueroll view $(OUT)/overhead_pool"

app: .venv/.program
	$(BIN)/trueroll app --library $(OUT)

test: .venv/.tools
	$(BIN)/python -m pytest -n auto --dist worksteal $(ARGS)

# Kernels of OpenBLAS round differently, so what passes under one can fail on another processor.
test-kernels: .venv/.tools
	@for kernel in $(KERNELS); do \
		echo "Tests of linear algebra with the kernel $$kernel of OpenBLAS"; \
		OPENBLAS_CORETYPE=$$kernel $(BIN)/python -m pytest -n auto --dist worksteal $(ARGS) $(NUMERICAL_TESTS) || exit 1; \
	done

check: .venv/.tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest tests/test_layering.py tests/test_names.py

mutants: .venv/.tools
	$(BIN)/python -m benchmarks.mutants $(ARGS)

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "Look at site/index.html; or, with full-text search: $(BIN)/mkdocs serve"

notebooks: .venv/.notebooks
	$(BIN)/jupyter lab docs/notebooks

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

.venv/.program: pyproject.toml .ci/install.py | $(BIN)/python
	@echo "Setting up .venv: some 65 packages are downloaded and installed."
	$(BIN)/python .ci/install.py -e .
	@touch $@

.venv/.tools: .venv/.program
	$(BIN)/python .ci/install.py -e ".[dev,check,train]"
	@touch $@

.venv/.docs: .venv/.program
	$(BIN)/python .ci/install.py -e ".[docs]"
	@touch $@

.venv/.notebooks: .venv/.program
	$(BIN)/python .ci/install.py -e ".[notebooks]"
	@touch $@
