# The two commands are `make demo` and `make test`; `make help` lists all.
SHELL := /bin/bash
export CARGO_TARGET_DIR ?= $(CURDIR)/target
bin := $(CARGO_TARGET_DIR)/quick

.PHONY: help demo test test-kernels test-upstream check docs bench fuzz dist router

help: ## This list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

demo: ## Two simulated Wombats talk over Bluetooth Low Energy (about half a minute after the build)
	@scripts/setup demo
	@cargo build --profile quick -p rect -p rect-router
	@PATH="$(bin):$$PATH" .venv/bin/python examples/demo/two_wombats.py

test: ## Every test, the Bluetooth VM included
	@scripts/setup test
	@scripts/test

test-kernels: ## The Bluetooth tests on the kernels of Debian 11, 12 and 13
	@scripts/setup test
	@scripts/test-vm 11 12 13

test-upstream: ## Zenoh's own tests of its crate zenoh-transport, with our links in it (half an hour the first time)
	@scripts/test-upstream

check: ## Formatters and linters of every language
	@scripts/setup test
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	cargo clippy -p rect --no-default-features --lib -- -D warnings
	.venv/bin/ruff check . && .venv/bin/ruff format --check .
	.venv/bin/shellcheck -x $$(git ls-files | xargs grep -lE '^#!.*bash' --)

docs: ## The API's pages for Rust, Python and C++, into target/doc, target/docs and rect-cpp/build/doxygen
	@scripts/setup python
	@scripts/setup test
	cargo doc --no-deps -p rect
	@scripts/docs-python
	mkdir -p rect-cpp/build/doxygen && cd rect-cpp && doxygen -q Doxyfile

bench: ## Comparisons, into benches/results/ (an hour; BENCH="goodput idle" for some of them)
	@scripts/setup bench
	@scripts/bench $(BENCH)

fuzz: ## The fuzz targets, SECONDS_EACH=300 (needs the nightly toolchain and cargo-fuzz)
	@scripts/fuzz $(or $(SECONDS_EACH),300)

dist: ## What is published, into dist/: packages, wheels, archives for amd64 and arm64 (an hour)
	@scripts/dist

router: ## Just the router and the rect tool, in release form
	cargo build --release -p rect -p rect-router
