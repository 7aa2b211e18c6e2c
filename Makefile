# Needs Python >= 3.11, make and git; uses uv where it is installed. Everything lands in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SENTENCE ?= two people shake hands
# Two dancers, two cores: more threads than that only get in each other's way.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Processes that share the tests; a test that holds a deadline of the wall clock runs alone.
WORKERS ?= auto
PARALLEL := -n $(WORKERS) --maxprocesses=8 --dist=worksteal --durations=30

.PHONY: help demo test test-fast check format bench bench-track results strip clean

help:
	@echo "make demo       install, then turn a sentence into two moving puppets (out/)"
	@echo "make test       install the test tools, then run all tests on all cores"
	@echo "make test-fast  the same without the slow ones"
	@echo "make check      formatting, lint, types, package borders"
	@echo "make bench      benchmarks, one figure each"
	@echo "make bench-track  hours: controllers on 126 duets; may be stopped and goes on"
	@echo "make results    hours: every figure of docs/results.md; may be stopped and goes on"
	@echo "make strip      the picture of eight sentences in the README"
	@echo "make clean      remove .venv and everything built"

demo: $(VENV)/.installed
	$(BIN)/pasdedeux run "$(SENTENCE)"

# Both halves run whatever the first one says; make fails if either did. The second one reads only
# the files that name its mark.
REALTIME = $$(grep -rlw realtime tests --include='test_*.py')
test: $(VENV)/.installed-dev
	@status=0; \
	$(BIN)/pytest $(PARALLEL) -m "not realtime" || status=1; \
	$(BIN)/pytest -m realtime --durations=15 $(REALTIME) || status=1; \
	exit $$status

test-fast: $(VENV)/.installed-dev
	$(BIN)/pytest $(PARALLEL) -m "not slow and not realtime"
	$(BIN)/pytest -m "realtime and not slow" $(REALTIME)

check: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --threads 2
	$(BIN)/lint-imports

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.installed-dev
	@for name in generate linearize retarget score stream track; do \
	  $(BIN)/python -m benchmarks.$$name || exit 1; done

bench-track: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.tracking $(TRACK)
	$(BIN)/python -m benchmarks.tracking --ablation
	$(BIN)/python -m benchmarks.tracking.table

# CLIPS=DIR adds real duets: their spectra, and a small model that learns from some of them.
results: $(VENV)/.installed-dev
	@if [ -n "$(CLIPS)" ]; then $(BIN)/python -m benchmarks.results --clips "$(CLIPS)"; fi
	$(BIN)/pasdedeux curate configs/physics/repaired.toml --limit 400
	$(BIN)/python -m benchmarks.results --train-ablations
	$(BIN)/python -m benchmarks.results
	$(BIN)/python -m benchmarks.results.table

strip: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.strip $(STRIP)

clean:
	rm -rf $(VENV) build dist out .pytest_cache .ruff_cache .hypothesis .import_linter_cache

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "pasdedeux needs Python 3.11 or newer: make PYTHON=/path/to/python3.11 ..."; exit 1; }
	@if command -v uv >/dev/null 2>&1; then uv venv --quiet --python $(PYTHON) $(VENV); \
	 else $(PYTHON) -m venv $(VENV) || \
	  { echo "python -m venv failed (Debian: apt-get install python3-venv)"; exit 1; }; fi
	@touch $@

$(VENV)/.installed: $(VENV)/.python pyproject.toml constraints.txt
	@echo "installing into $(VENV) (a minute or two) ..."
	@if command -v uv >/dev/null 2>&1; \
	 then VIRTUAL_ENV=$(VENV) uv pip install --quiet -c constraints.txt -e '.[view]'; \
	 else $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[view]'; fi
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@echo "installing the test tools ..."
	@if command -v uv >/dev/null 2>&1; \
	 then VIRTUAL_ENV=$(VENV) uv pip install --quiet -c constraints.txt -e '.[view,release,dev]'; \
	 else $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[view,release,dev]'; fi
	@touch $@
