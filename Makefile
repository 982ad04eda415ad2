# `make demo` and `make test` are the most important commands; `make help` lists all.
SHELL := /bin/bash
export CARGO_TARGET_DIR ?= $(CURDIR)/target
bin := $(CARGO_TARGET_DIR)/debug

.PHONY: help demo test test-all test-kernels test-upstream check docs docs-serve python cpp bench report soak survey-sim fuzz dist router

help: ## List the commands
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

demo: ## Show two simulated Wombats on Bluetooth Low Energy (half a minute after the build)
	@scripts/setup demo
	@scripts/build-programs
	@PATH="$(bin):$$PATH" .venv/bin/python examples/demo/two_wombats.py

test: ## Run the tests that every change must pass, in 25 minutes (JOBS="unit vm": only these jobs)
	@scripts/setup $(if $(JOBS),test-all,test)
	@scripts/test $(JOBS)

test-all: ## Run all jobs of CI, in at most 45 minutes: those of make test, and the rest (scripts/test --list lists both)
	@scripts/setup test-all
	@scripts/test --all

test-kernels: ## Run the Bluetooth tests on the kernels of Debian 11, 12 and 13
	@scripts/setup test
	@scripts/test-vm 11 12 13

test-upstream: ## Run the tests of Zenoh's crate zenoh-transport with our links (half an hour the first time)
	@scripts/test-upstream

check: ## Check the format, lints and vocabulary of all languages
	@scripts/setup test
	@scripts/test format lints

docs: ## Build the documentation site with the API of each language into target/site
	@scripts/setup docs
	@scripts/docs

docs-serve: ## Show the documentation site at http://127.0.0.1:8000 while you edit its pages
	@scripts/setup docs
	.venv/bin/python -m mkdocs serve

python: ## Install the Python package into .venv, with the router and the rect tool
	@scripts/setup python
	@scripts/install-python

cpp: ## Build the C++ library without optimisation, and the example hello with it, in rect-cpp/build/hello
	@scripts/setup cpp
	@scripts/build-programs -p rect-cpp
	@cmake -S rect-cpp -B rect-cpp/build/hello -G Ninja -DRECT_LIBRARY_DIR=$(bin) -DRECT_BUILD_TESTS=OFF
	@cmake --build rect-cpp/build/hello --target example_hello
	@echo 'start `rect sim`, and then rect-cpp/build/hello/examples/hello'

bench: ## Run the benches, and write their tables to benches/results/ (an hour; BENCH="goodput idle" selects some)
	@scripts/setup bench
	@scripts/bench $(BENCH)

report: ## Print the measurements with plots as a PDF (MEASURE="radio goodput": measure these first; MEASURE=all: all)
	@scripts/setup bench
	@[[ -z "$(MEASURE)" ]] || scripts/bench $(filter-out all,$(MEASURE))
	@scripts/report

soak: ## Run ten robots with traffic and faults for two hours (HOURS=6: for six)
	@scripts/setup bench
	@scripts/soak --hours $(or $(HOURS),2)

survey-sim: ## Run `rect survey` on the simulated air, and write surveys/simulated-air.json (5 minutes after the build)
	@scripts/setup demo
	@scripts/build-programs
	@PATH="$(bin):$$PATH" scripts/survey-sim

fuzz: ## Run each fuzz target for 300 s (SECONDS_EACH=60: for 60 s)
	@scripts/setup test-all
	@scripts/fuzz $(or $(SECONDS_EACH),300)

dist: ## Build packages, wheels and archives for amd64 and arm64 into dist/ (an hour)
	@scripts/dist

router: ## Build only the router and the rect tool, with the release profile
	cargo build --release -p rect-cli -p rect-router
