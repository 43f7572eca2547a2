# Two commands matter: `make demo` and `make test`. Each sets everything up in .venv first, with uv where it is on the
# PATH and with venv + pip otherwise, from the versions in uv.lock or in constraints.txt, which say the same.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.stamp
DOCS_STAMP := $(VENV)/.stamp-docs
SLOW_STAMP := $(VENV)/.stamp-slow
WORKERS ?= 2

UV := $(shell uv --version 2>/dev/null)
# The first interpreter of a version that we support; `make PYTHON=...` overrides it.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' >/dev/null 2>&1 && echo $$p && break; done)
PIP := $(BIN)/python -m pip --disable-pip-version-check

# uv trusts the certificates that it brings along. Behind a proxy with its own it needs the system's, hence the second try.
# Bytecode is compiled at once, as pip does: tests start many processes, some at the same time.
SYNC := UV_COMPILE_BYTECODE=1 UV_PROJECT_ENVIRONMENT=$(VENV) uv sync --frozen
define uv_sync
	$(SYNC) $(1) || UV_SYSTEM_CERTS=1 UV_NATIVE_TLS=1 $(SYNC) $(1)
endef

.DEFAULT_GOAL := help
.PHONY: help setup demo test fast test-slow faults fuzz lint docs bench evidence evidence-gpu lock clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## the environment in .venv, with the tools for tests

demo: $(STAMP) ## the main job on data that we make ourselves: collect, learn, judge; see runs/demo/report.html
	$(BIN)/deadreckon demo --out runs/demo

# Beside each other: what lint finds is told while tests run.
test: $(STAMP) ## lint and the fast tests
	@$(MAKE) --no-print-directory -j 2 lint fast

# Our own bytecode is kept, too, whatever the shell says: every command that a test starts would compile it again.
fast: $(STAMP) ## the fast tests alone
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

test-slow: $(SLOW_STAMP) ## the tests marked slow: learning, kills, the built wheel
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m slow

faults: $(STAMP) ## kills commands N=100 times and disturbs them otherwise, at the lowest priority; goes on with RESULTS=FILE
	nice -n 19 $(BIN)/python -m tests.faults --kills $(or $(N),100) $(if $(RESULTS),--results $(RESULTS))
	$(BIN)/python -m tests.faults --table $(if $(RESULTS),--results $(RESULTS))

lint: $(STAMP) ## ruff, import-linter, pyrefly
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyrefly check --python-interpreter-path $(BIN)/python

docs: $(DOCS_STAMP) ## the site in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(STAMP) ## the speed figures that docs/results/speed.md has places for, on an idle machine, about half an hour
	$(BIN)/python benchmarks/report.py

fuzz: $(STAMP) ## damaged files of every format at the lowest priority: N=100000 inputs or FOR=2h, FORMATS="hdf5 pickle", RESULTS=FILE
	$(BIN)/python -m tests.fuzz $(if $(N),--inputs $(N)) $(if $(FOR),--for $(FOR)) $(if $(FORMATS),--only $(FORMATS)) \
		$(if $(RESULTS),--results $(RESULTS))

evidence: $(STAMP) ## what the results still lack, at the lowest priority; FOR=150m ends it after that time
	$(BIN)/deadreckon bench evidence/queue.toml --out .cache/evidence --idle --trust evidence.studies $(if $(FOR),--for $(FOR))

evidence-gpu: $(STAMP) ## fills a GPU with what they lack for FOR=40m; PLAN=1 prints the plan alone
	$(BIN)/deadreckon bench evidence/queue.toml --out .cache/evidence \
		--trust evidence.studies --gpu --for $(or $(FOR),40m) $(if $(PLAN),--dry-run)

lock: ## uv.lock and constraints.txt anew from pyproject.toml (needs uv)
	uv lock
	uv export --quiet --frozen --no-hashes --no-annotate --no-header --no-emit-project --all-groups \
		--format requirements.txt --output-file constraints.txt

clean: ## removes what the targets above have made, except collected logs and downloads
	rm -rf $(VENV) .cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache dist site runs/demo

$(STAMP): pyproject.toml uv.lock constraints.txt
ifneq ($(UV),)
	$(call uv_sync)
else
	@test -n "$(PYTHON)" || { echo "make: deadreckon needs Python 3.11, 3.12 or 3.13 (or uv) and finds none on the PATH" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "make: $(PYTHON) has no venv; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) install --quiet --upgrade 'pip>=25.1'
	$(PIP) install --quiet --constraint constraints.txt --editable . --group dev
endif
	@touch $@

$(DOCS_STAMP): $(STAMP)
ifneq ($(UV),)
	$(call uv_sync,--inexact --group docs)
else
	$(PIP) install --quiet --constraint constraints.txt --group docs
endif
	@touch $@

$(SLOW_STAMP): $(STAMP)
ifneq ($(UV),)
	$(call uv_sync,--inexact --group slow)
else
	$(PIP) install --quiet --constraint constraints.txt --group slow
endif
	@touch $@
