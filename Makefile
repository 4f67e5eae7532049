# Every target builds .venv from the lock files first, if it is missing or older than they are.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUNTIME := $(VENV)/.runtime
DEV := $(VENV)/.dev
BENCH := $(VENV)/.bench

# Markers of the tests that need foreign programs, or a minute of waiting.
PEERS := node or compiler or milo or languages or broker or mosquitto or image or chromium or minor \
    or tutorial or notebooks

# The files that hold a marker of some, joined by "or": to collect all others, too, takes a process
# a quarter of a minute.
marked = $(shell grep -rlE --include='*.py' 'pytest\.mark\.($(subst $() or ,|,$(1)))\b' tests)

# Many tests start programs; without kept bytecode each of them compiles all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install demo test works waits peers conformance hardened lint format soak bench report simulate reference figures docs sbom wheel release verify-release lock clean

# Kernels are compiled here, in place of the first start: two minutes, once.
install: $(RUNTIME)
	@$(BIN)/valvemap warm-up

demo: $(RUNTIME)
	@$(BIN)/valvemap demo

test: $(DEV)
	PYTHONPATH=tests:. $(BIN)/python -m support.kernels
	$(MAKE) --no-print-directory --jobs 3 --output-sync=target works lint waits
	$(BIN)/python -m pytest -m "alone and not (soak or $(PEERS))" $(call marked,alone)

# Tests that compute. They are nice: tests that wait find the processor free when they need it, and
# these use it meanwhile.
works: $(DEV)
	nice -n 10 $(BIN)/python -m pytest -n 2 --dist worksteal \
	    -m "not (soak or alone or waits or $(PEERS))"

# Tests that mostly wait, for connections to end or samples to come.
waits: $(DEV)
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "waits and not (soak or alone or $(PEERS))" $(call marked,waits)

# Files that compile for minutes in few tests. They come first: xdist would begin with the files of
# most tests, and at the end compile in one process while the others wait.
COMPILING := tests/test_package.py tests/model/test_numba_minors.py tests/opcua/test_foreign_clients.py

# Two files side by side: foreign programs start and wait for long. What draws comes last: two
# browsers share the processor with nothing else.
peers: $(DEV)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder \
	    -m "($(PEERS)) and not (soak or chromium)" \
	    $(COMPILING) $(filter-out $(COMPILING),$(sort $(call marked,$(PEERS))))
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "chromium and not soak" $(call marked,chromium)

# The guarded server alone: copied out of the tree with its tests, it must import and pass.
hardened: $(DEV)
	@folder=$$(mktemp -d) && trap 'rm -rf $$folder' EXIT && python=$$PWD/$(BIN)/python && \
	    mkdir -p $$folder/service $$folder/tests/opcua && \
	    cp -r service/guarded_opcua $$folder/service && cp pyproject.toml $$folder && \
	    cp -r tests/guarded_opcua tests/support tests/conftest.py $$folder/tests && \
	    cp -r tests/opcua/node_peer $$folder/tests/opcua && \
	    cd $$folder && $$python -m pytest -q -m "not soak" tests/guarded_opcua service/guarded_opcua && \
	    PYTHONPATH=service $$python -c "import guarded_opcua as alone; print(alone.__file__)"

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

soak: $(DEV)
	$(BIN)/python -m pytest -m soak --timeout 7200

# The live service in a simulated world: make simulate [SEEDS=1000] [FIRST=0], or SEED=n for one.
SEEDS ?= 1000
FIRST ?= 0
simulate: $(DEV)
	@PYTHONPATH=service:virtual_rig:tests $(BIN)/python -m simulation --seeds $(SEEDS) \
	    --first $(FIRST) $(if $(SEED),--seed $(SEED))

bench: $(BENCH)
	$(BIN)/python -m benchmarks.accuracy
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.hostile

report: $(RUNTIME)
	$(BIN)/valvemap report --out reports --force

# The reference pages of the documentation, from models, commands and a running server.
reference: $(DEV)
	$(BIN)/python -m documentation

# The sweeps of docs/conformance.md, by node-opcua, gopcua, Eclipse Milo and open62541.
conformance: $(DEV)
	@PYTHONPATH=service:virtual_rig:tests:. $(BIN)/python -m conformance

# The figures of docs/methods: make figures [PAGES="auto survey"]
figures: $(DEV)
	$(BIN)/python -m documentation.figures $(PAGES)

docs: $(DEV)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# What the image holds, as CycloneDX.
sbom: $(DEV)
	$(BIN)/python -m documentation.bill_of_materials

# Wheel, sdist, images and their bills of materials, signed: make release KEY=FILE [DIST=FOLDER]
# [PYTHON_IMAGE=NAME@DIGEST] [IMAGES=no]. KEY is a key of ssh-keygen; see docs/release.md.
IMAGES ?= yes
release: $(DEV)
	@$(BIN)/python -m release --key="$(KEY)" --out="$(DIST)" --images="$(IMAGES)" \
	    --base="$(PYTHON_IMAGE)"

# make verify-release DIST=FOLDER SIGNERS=FILE
verify-release:
	@$(PYTHON) release/verify.py "$(DIST)" "$(SIGNERS)"

# A wheel for this Python and platform that holds its kernels compiled; without VALVEMAP_KERNELS
# it would be a pure one.
wheel: $(RUNTIME)
	VALVEMAP_KERNELS=$$PWD/$(BIN)/python $(BIN)/python -m pip wheel --quiet \
	    --disable-pip-version-check --no-deps --wheel-dir dist .

# The widest first: what it pins fits everybody (Quix Streams wants an older pydantic).
lock:
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --all-extras --group dev --group bench pyproject.toml -o requirements-bench.lock
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --all-extras --group dev pyproject.toml -c requirements-bench.lock -o requirements-dev.lock
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --extra dashboard --extra mqtt --extra plot --extra parquet pyproject.toml \
	    -c requirements-dev.lock \
	    -o requirements.lock
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --extra dashboard --extra mqtt pyproject.toml -c requirements.lock \
	    -o requirements-image.lock
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --extra dashboard --extra fleet --extra mqtt pyproject.toml -c requirements-dev.lock \
	    -o requirements-fleet.lock
	uv pip compile --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
	    --group pyproject.toml:release -o requirements-release.lock

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

$(RUNTIME): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "valvemap needs Python 3.11 or newer; set PYTHON=/path/to/python3")'
	@echo "installing into $(VENV): a minute or two, once ..."
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

$(DEV): $(RUNTIME) requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

$(BENCH): $(DEV) requirements-bench.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-bench.lock
	@touch $@
