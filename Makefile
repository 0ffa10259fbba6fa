# The README's commands. Everything is installed into .venv; nothing else on the machine is touched.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# uv takes a tenth of pip's time. The machine's certificates, as pip; maturin of .venv, as Cargo would build PyO3 anew for a Python in a new place.
INSTALL := $(BIN)/uv pip install --quiet --system-certs --no-build-isolation-package linkside --python $(BIN)/python -c constraints.txt

# Units stand in brackets, as links do.
RUSTDOC := RUSTDOCFLAGS="-D warnings -A rustdoc::broken-intra-doc-links" cargo doc --locked --no-deps -p linkside-core -p linkside-bag -p linkside-compiled --target-dir target

PREFIX ?= /usr/local

unexport MAKEFLAGS # with `--jobs`: Cargo and CMake count their own

.PHONY: demo checked test test-debug test-release guards lint lint-rust lint-python fuzz soak mutants coverage bench latency header install-c docs figures lock licences clean

demo: $(BIN)/uv ## build, install, run the main job on the recording inside the package
	$(INSTALL) .
	$(BIN)/linkside demo

checked: $(BIN)/uv # installed once for `make lint test`
	$(INSTALL) ".[test,lint]"

test: test-debug test-release ## everything that must hold

test-debug:
	RUSTFLAGS="--cfg one_level" cargo test --locked -p linkside-core -p linkside-bag -p linkside-compiled -p linkside-capi

test-release: checked
	cargo test --locked --workspace --release --features linkside-capi/header --test '*' # of the workspace: with the wheel's features, on its build of the core
	$(BIN)/python -m mypy.stubtest linkside._core
	LINKSIDE_CAPI=target/release/deps OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile # a worker a core, not two

guards: ## instructions that kernels take, beside those on record; WRITE=1 renews the record
	$(if $(WRITE),LINKSIDE_WRITE_GUARDS=1) cargo test --locked --workspace --release --features linkside-capi/header --test guards # on the build of `test`

lint: lint-rust lint-python

lint-rust:
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	cargo clippy --locked --workspace --test guards -- -D warnings
	$(RUSTDOC)

lint-python: checked
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

SECONDS ?= 3600
fuzz: checked ## every target for SECONDS, two at a time
	$(INSTALL) atheris
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
	$(INSTALL) coverage
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m coverage run --branch --source linkside -m pytest
	$(BIN)/python -m coverage report --skip-covered --sort cover

bench: $(BIN)/uv ## beside what one would use instead
	$(INSTALL) ".[test,bench]"
	$(BIN)/python benches/python/run.py

latency: $(BIN)/uv ## the slowest of 10⁶ steps of a controller's loop, for 3, 6 and 7 joints
	$(INSTALL) ".[test]"
	mkdir -p target/latency
	cargo run --locked --release -p linkside-compiled --example latency -- 1e6 $$($(BIN)/python benches/python/latency.py target/latency)

header: ## rust/capi/include/linkside.h, of the functions that are there
	LINKSIDE_WRITE_HEADER=1 cargo test --locked -p linkside-capi --features header --test header

install-c: ## the C library, its headers, CMake package and pkg-config file, below PREFIX
	cargo build --locked --release -p linkside-capi
	rust/capi/install/install.sh target/release $(PREFIX)

docs: $(BIN)/uv ## the pages, and the API reference of both languages beside them, into site
	$(INSTALL) ".[docs]"
	$(RUSTDOC)
	rm -rf site
	PYTHONPATH=docs $(BIN)/zensical build --strict
	cp -r target/doc site/rust
	$(BIN)/python docs/notebooks.py site/tutorials

figures: $(BIN)/uv ## draw every figure of the pages anew, some minutes
	$(INSTALL) ".[docs]"
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/figures.py

lock: $(BIN)/uv ## renew constraints.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.10 --all-extras --no-emit-index-url --no-annotate \
	    --custom-compile-command "make lock" pyproject.toml -o constraints.txt

licences: ## renew THIRD-PARTY-LICENSES.txt, after Cargo.lock
	$(PYTHON) docs/licences.py

clean:
	rm -rf $(VENV) target site

$(BIN)/uv:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt uv "maturin>=1.16,<2"
