# FAST: `make campaign` and `make test` each set everything up on a fresh machine, then do their job.
PYTHON ?= python3.11
VENV ?= .venv
BIN = $(VENV)/bin
# One thread per process: the campaign runs several processes side by side.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# Compiled modules are kept, whatever the shell says: every process starts a third of a second sooner.
export PYTHONDONTWRITEBYTECODE =

# uv installs what pip does in a tenth of the time; where it cannot be had, or fails, pip does it.
# uv knows none of pip's settings, so that an index or a folder of files that pip has is handed on.
# pip says what it does where someone watches; a log gets the lines of the steps alone.
QUIET = $(if $(MAKE_TERMOUT),,--quiet)
PIP = $(BIN)/python -m pip --disable-pip-version-check $(QUIET)
PIP_HAS = $(BIN)/python -m pip config list 2>/dev/null | sed -n "s/^[a-z:]*\.$(1)='\(.*\)'$$/\1/p" | head -n 1
define INSTALL
links="$$($(call PIP_HAS,find-links))"; index="$$($(call PIP_HAS,index-url))"; \
{ test -x $(BIN)/uv && $(BIN)/uv pip install --quiet --python $(BIN)/python \
	$${links:+--find-links "$$links"} $${index:+--default-index "$$index"} $(1); } \
|| $(PIP) install --no-compile $(1)
endef

# Many tests wait for devices and servers: two processes more than there are cores.
TEST_WORKERS ?= $(shell expr $$(nproc) + 2)

.PHONY: help setup kernels campaign test studies check pages docs dist audit-online format lock clean

help:           ## list the commands
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

setup: $(VENV)/.ready  ## virtual environment from the lock file

$(VENV)/.ready: requirements.lock pyproject.toml
	@echo "Setting up $(VENV), once: about 3 GB of packages, one minute and the time to load them."
	@echo "1 of 4: an empty environment, and uv, which fills it"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) install --quiet "$$(grep '^uv==' requirements.lock)" || echo "   uv cannot be had here: pip installs, which takes minutes"
	@echo "2 of 4: torch, the largest package"
	@$(call INSTALL,torch==2.13.0)
	@echo "3 of 4: the other $$(grep -c == requirements.lock) packages"
	@$(call INSTALL,-r requirements.lock)
	@echo "4 of 4: FAST itself, and one import of what it uses, which compiles that and nothing else"
	@$(call INSTALL,--no-deps --no-build-isolation -e .)
	@# It leaves at once: else DuckDB lists what it has not freed, fifty lines that look like a fault.
	@$(BIN)/python -W ignore::FutureWarning -c "import fast.flows.campaign.flow, prefect.server.api.server, botorch, pymc, rerun, distributed, os; os._exit(0)"
	@touch $@
	@echo "$(VENV) is ready."

kernels: setup  ## compile all kernels once, and make an empty Prefect database, so that no test or worker has to
	$(BIN)/python -m tests.kernels

campaign: setup ## a small complete campaign on the virtual bench, with report and recording
	$(BIN)/fast campaign run campaigns/quick.toml --auto-print

test: kernels   ## the test suite
	$(BIN)/python -m pytest -n $(TEST_WORKERS) --dist loadfile --no-loadscope-reorder --durations=40 --durations-min=5

studies: setup  ## tests that take minutes; `python -m tests.studies list` names the studies behind the docs
	$(BIN)/python -m pytest -m study

check: setup    ## format, lint, types, import layers, packages as locked
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.package_audit

pages: setup    ## write what the reference says of commands, configs, tables and effects
	$(BIN)/python -m tests.docs.generated

docs: pages     ## the documentation as a site, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

dist: setup     ## wheel and sdist in dist/, each tried in an environment of its own
	bash .ci/dist

audit-online: setup  ## known vulnerabilities of the locked packages; asks a public service
	$(PYTHON) -m venv $(VENV)-audit
	$(VENV)-audit/bin/python -m pip install --quiet --disable-pip-version-check pip-audit
	$(VENV)-audit/bin/pip-audit --no-deps --requirement requirements.lock

format: setup   ## format and fix what can be fixed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lock: setup     ## write requirements.lock from the environment (after changing pyproject.toml)
	$(BIN)/python -m pip freeze --all --exclude-editable | grep -v '^pip==' | sed 's/+cpu$$//' > requirements.lock

clean:          ## remove the environment and caches, never the lake
	rm -rf $(VENV) $(VENV)-audit .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache build *.egg-info
