# SPDX-License-Identifier: Apache-2.0
# What a person types. Each target sets up first what it needs; see tools/setup.sh.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup demo test checks lint bench docs lock sbom clean

help: ## this list
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/  make \1\t\2/p' Makefile | expand -t 16

setup: ## environment in .venv, both packages in install/
	@tools/setup.sh

demo: setup ## replay a bag into the identifier node and watch it find the parameters
	@. ./env.sh; tools/demo.sh

test: setup ## all tests; ARGS='-k search' for some
	@. ./env.sh; tools/test.sh $(ARGS)

checks: setup ## kept blind checks against their seals, then 8 new cases and the paper's experiments
	@. ./env.sh; tools/checks.sh

lint: setup ## ruff, mypy, imports, licence headers
	@. ./env.sh; tools/lint.sh

bench: setup ## figures of docs/figures.md again, 6 minutes; ARGS=latency for some
	@. ./env.sh; tools/bench.sh $(ARGS)

docs: setup ## the documentation as a site, build/docs/index.html
	@. ./env.sh; tools/docs.sh

sbom: setup ## what the environment consists of, CycloneDX, build/sbom.cdx.json
	@. ./env.sh; python tools/sbom.py build/sbom.cdx.json

lock: ## newest versions of everything into requirements.lock
	@tools/lock.sh

clean: ## remove everything that was made here
	rm -rf .venv build install log
