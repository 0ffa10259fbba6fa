# The README's commands. Everything is installed into .venv; nothing else on the machine is touched.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# Units stand in brackets, as links do.
RUSTDOC := RUSTDOCFLAGS="-D warnings -A rustdoc::broken-intra-doc-links" cargo doc --locked --no-deps -p linkside-core -p linkside-bag -p linkside-compiled --target-dir target

PREFIX ?= /usr/local

.PHONY: demo checked test guards lint fuzz soak mutants coverage bench latency header install-c docs figures lock licences clean

demo: $(VENV) ## build, install, run the main job on the recording inside the package
	$(PIP) .
	$(BIN)/linkside demo

checked: $(VENV) # installed once for `make lint test`
	$(PIP) ".[test,lint]"

test: checked ## everything that must hold
	RUSTFLAGS="--cfg one_level" cargo test --locked -p linkside-core -p linkside-bag -p linkside-compiled -p linkside-capi
	cargo test --locked --workspace --release --features linkside-capi/header --test '*' # of the workspace: with the wheel's features, on its build of the core
	$(BIN)/python -m mypy.stubtest linkside._core
	LINKSIDE_CAPI=target/release/deps OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile # a worker a core, not two

guards: ## instructions that kernels take, beside those on record; WRITE=1 renews the record
	$(if $(WRITE),LINKSIDE_WRITE_GUARDS=1) cargo test --locked --workspace --release --features linkside-capi/header --test guards # on the build of `test`

lint: checked
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	cargo clippy --locked --workspace --test guards -- -D warnings
	$(RUSTDOC)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

SECONDS ?= 3600
fuzz: checked ## every target for SECONDS, two at a time
	$(PIP) atheris
	fuzz/build.sh
	OPENBLAS_NUM_THREADS=1 $(BIN)/python fuzz/all.py --seconds $(SECONDS)

SAMPLES ?= 1e7
soak: checked ## every filter for SAMPLES samples of a moving arm, against the truth
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/python/soak.py --samples $(SAMPLES)

MUTANTS ?= --file 'rust/core/src/estimate/**' --file 'rust/core/src/dynamics/**'
mutants: ## changes of the core that no test notices; MUTANTS='--shard 1/100' takes a part of them
	cargo install --locked cargo-mutants
	RUSTFLAGS="--cfg one_level" cargo mutants --package linkside-core --output target $(MUTANTS)

LLVM ?= 22
coverage: checked ## lines and branches that tests run; needs llvm-profdata and llvm-cov of the version that rustc has
	tests/coverage.sh $(LLVM)
	$(PIP) coverage
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m coverage run --branch --source linkside -m pytest
	$(BIN)/python -m coverage report --skip-covered --sort cover

bench: $(VENV) ## beside what one would use instead
	$(PIP) ".[test,bench]"
	$(BIN)/python benches/python/run.py

latency: $(VENV) ## the slowest of 10⁶ steps of a controller's loop, for 3, 6 and 7 joints
	$(PIP) ".[test]"
	mkdir -p target/latency
	cargo run --locked --release -p linkside-compiled --example latency -- 1e6 $$($(BIN)/python benches/python/latency.py target/latency)

header: ## rust/capi/include/linkside.h, of the functions that are there
	LINKSIDE_WRITE_HEADER=1 cargo test --locked -p linkside-capi --features header --test header

install-c: ## the C library, its headers, CMake package and pkg-config file, below PREFIX
	cargo build --locked --release -p linkside-capi
	rust/capi/install/install.sh target/release $(PREFIX)

docs: $(VENV) ## the pages, and the API reference of both languages beside them, into site
	$(PIP) ".[docs]"
	$(RUSTDOC)
	rm -rf site
	PYTHONPATH=docs $(BIN)/zensical build --strict
	cp -r target/doc site/rust
	$(BIN)/python docs/notebooks.py site/tutorials

figures: $(VENV) ## draw every figure of the pages anew, some minutes
	$(PIP) ".[docs]"
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/figures.py

lock: $(VENV) ## renew constraints.txt
	$(PIP) uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.10 --all-extras --no-emit-index-url --no-annotate \
	    --custom-compile-command "make lock" pyproject.toml -o constraints.txt

licences: ## renew THIRD-PARTY-LICENSES.txt, after Cargo.lock
	$(PYTHON) docs/licences.py

clean:
	rm -rf $(VENV) target site

$(VENV):
	$(PYTHON) -m venv $(VENV)
