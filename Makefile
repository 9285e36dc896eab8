# Two commands: `make demo` and `make test`. Both set everything up in .venv first.
# On Debian a fresh machine needs: python3.11 python3.11-venv g++ make, and for bpy libxi6 libxrender1 libxkbcommon0 libsm6 libgl1.
PYTHON ?= python3.11
# An environment for each Python: .venv, and .venv-3.13 for `make test PYTHON=python3.13`.
VENV := .venv$(patsubst python%,-%,$(filter-out python3.11,$(filter python3.%,$(notdir $(PYTHON)))))
BIN := $(VENV)/bin
CAPTURE ?= room
OUT ?= out/$(CAPTURE)
# Where pip finds a CPU build of torch by itself (as on macOS) nothing is needed here; see the README for Linux and CUDA.
PIP_FLAGS ?=
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check -q -c constraints.txt $(PIP_FLAGS)
NATIVE := $(wildcard frog_blender/engine/native/src/* frog_blender/engine/native/src/*/*) CMakeLists.txt pyproject.toml blender_manifest.toml

# The CUDA run-time compiler, for tests that compile every kernel; there is none for macOS.
NVRTC := $(if $(filter Darwin,$(shell uname)),,nvidia-cuda-nvrtc-cu12)

.PHONY: demo chart stability experiment-tables test test-fast test-slow test-sanitizers test-blender test-bpy45 test-bpy53 test-web test-clients cross tour lint format extension release clean setup

setup: $(VENV)/.ready

$(VENV)/.packages: constraints.txt pyproject.toml
	$(BIN)/python -m pip --version > /dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(INSTALL) scikit-build-core cmake ninja
	$(INSTALL) torch numpy safetensors opencv-contrib-python-headless av pillow tqdm imageio-ffmpeg matplotlib flip-evaluator pycolmap bpy pytest pytest-xdist hypothesis jsonschema plyfile ruff mypy import-linter usd-core fourdgs zstandard distributed cryptography $(NVRTC)
	touch $@

$(VENV)/.ready: $(VENV)/.packages $(NATIVE)
	$(INSTALL) --no-build-isolation --no-deps -e .
	touch $@

demo: setup
	$(BIN)/python examples/demo.py --capture $(CAPTURE) --out $(OUT)

# Trains every method on the bundled captures, for hours; killed, it goes on where it stopped. CHART_FLAGS overrides the grid.
CHART_CAPTURES ?= examples/captures/room examples/captures/dim examples/captures/fast
CHART_OUT ?= out/chart
CHART_FLAGS ?= --ablation --equal-time --timing

chart: setup
	$(BIN)/frog chart $(CHART_CAPTURES) --out $(CHART_OUT) $(CHART_FLAGS)

# Renders the captures that `room`, `dim` and `fast` do not stand for (an hour), then trains under every condition, for
# hours; killed, it goes on where it stopped. STABILITY_FLAGS overrides the grid.
STABILITY_OUT ?= out/stability
STABILITY_FLAGS ?=
RENDERED := out/captures

$(RENDERED)/long/cam06.mp4: setup
	test -e $@ || $(BIN)/python examples/make_long.py $(RENDERED)/long

$(RENDERED)/still/cam11.mp4: setup
	test -e $@ || $(BIN)/python examples/make_still.py $(RENDERED)/still

stability: $(RENDERED)/long/cam06.mp4 $(RENDERED)/still/cam11.mp4
	$(BIN)/frog stability examples/captures/room --long $(RENDERED)/long --dim examples/captures/dim \
		--appearing examples/captures/fast --still $(RENDERED)/still --out $(STABILITY_OUT) $(STABILITY_FLAGS)

# Every table and picture of docs/experiments, from the results kept there. New ones are kept by
# .venv/bin/python tools/experiment_tables.py --keep out/stability/runs.jsonl stability
experiment-tables: setup
	$(BIN)/python tools/experiment_tables.py

# A worker for each core, and a file's tests by one of them: they share what they prepare.
WORKERS ?= auto
test: setup
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile

# Under two minutes on two quiet cores: no whole training, no Blender (tests/conftest.py says what is left out).
test-fast: setup
	$(BIN)/python -m pytest -q -m "not slow and not integration"

test-slow: setup
	$(BIN)/python -m pytest -q -m slow

# The native library alone is built with sanitizers; the interpreter around it is not, so their libraries are loaded first.
# Leaks are not looked for: an interpreter leaves much behind at its end by intention.
SANITIZED := build/sanitizers
PRELOAD = $(shell $(CXX) -print-file-name=libasan.so):$(shell $(CXX) -print-file-name=libubsan.so)

POOL := frog_blender/engine/native/src

test-sanitizers: setup
	mkdir -p $(SANITIZED)/fuzz
	$(CXX) -std=c++17 -O1 -g -fsanitize=thread -I$(POOL) tests/native/thread_pool_races.cpp $(POOL)/threads/thread_pool.cpp \
		-pthread -o $(SANITIZED)/races
	$(SANITIZED)/races
	$(BIN)/cmake -S . -B $(SANITIZED) -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja \
		-DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_COMPILER=$(CXX) -DFROG_SANITIZE=ON
	$(BIN)/cmake --build $(SANITIZED)
	for set in avx512 avx2 baseline; do export FROG_INSTRUCTION_SET=$$set LD_PRELOAD="$(PRELOAD)" \
		FROG_NATIVE_LIBRARY=$(abspath $(SANITIZED))/libfrog_native.so ASAN_OPTIONS=detect_leaks=0:halt_on_error=1 \
		UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1; \
		$(BIN)/python -m pytest -q --capture=sys -p no:cacheprovider --ignore=tests/cuda \
		tests/rasterizer tests/native tests/model/test_fused.py tests/playback \
		tests/training/optimize/test_optimizer.py tests/training/optimize/test_losses.py || exit 1; \
		$(BIN)/python tests/fuzzing/worker.py scenes $(abspath $(SANITIZED))/fuzz 5000 4 || exit 1; done

# The oldest Blender that the add-on supports, as a module in an environment of its own.
BPY45 := .venv-bpy45

$(BPY45)/.ready: constraints.txt
	$(BPY45)/bin/python -m pip --version > /dev/null 2>&1 || $(PYTHON) -m venv --clear $(BPY45)
	sed 's/^bpy==[0-9.]*/bpy==4.5.15/' constraints.txt > $(BPY45)/constraints.txt
	$(BPY45)/bin/python -m pip install --disable-pip-version-check -q -c $(BPY45)/constraints.txt $(PIP_FLAGS) \
		bpy torch numpy safetensors opencv-contrib-python-headless av pillow zstandard tqdm pytest plyfile
	touch $@

test-bpy45: extension $(BPY45)/.ready
	FROG_ZIPS=dist $(BPY45)/bin/python tests/blender/run_in_blender.py -- -q -m "slow or not slow"

# The newest Blender, as a module; its Python is 3.13. Where pip finds only a build of torch with CUDA, that takes 6 GB.
PYTHON313 ?= $(firstword $(wildcard $(HOME)/.pyenv/versions/3.13*/bin/python3.13) python3.13)
BPY53 := .venv-bpy53

$(BPY53)/.ready: constraints.txt
	$(BPY53)/bin/python -m pip --version > /dev/null 2>&1 || $(PYTHON313) -m venv --clear $(BPY53)
	$(BPY53)/bin/python -m pip install --disable-pip-version-check -q -c constraints.txt $(PIP_FLAGS) \
		bpy torch numpy safetensors opencv-contrib-python-headless av pillow zstandard tqdm pytest plyfile
	touch $@

test-bpy53: extension $(BPY53)/.ready
	FROG_ZIPS=dist $(BPY53)/bin/python tests/blender/run_in_blender.py -- -q -m "slow or not slow"

# The Blender to test in and to walk through: make test-blender BLENDER=/path/to/blender (FROG_BLENDER names it as well).
BLENDER ?= $(or $(FROG_BLENDER),blender)

test-blender: extension
	@command -v $(firstword $(BLENDER)) > /dev/null || { echo "$(BLENDER): found no such program; say BLENDER=/path/to/blender"; exit 1; }
	FROG_ZIPS=$(abspath dist) $(BLENDER) -b --factory-startup --python tests/blender/run_in_blender.py -- -q -m "slow or not slow"

# Exported web pages in a browser without a window: chromium or google-chrome, or the one that FROG_CHROMIUM names.
test-web: setup
	$(INSTALL) playwright
	$(BIN)/python -m pytest -q -m slow tests/interchange/test_web_browser.py

# How others' programs open what is exported (tools/clients/clients.py), each in an environment of its own: Node 20 or
# later with npm, a Chromium, and Python 3.13 for Blender 5.3. Fills tables of docs/experiments/interchange.md.
CLIENTS := build/clients
CLIENT_FLAGS ?=

$(CLIENTS)/.node: tools/clients/package.json
	mkdir -p $(CLIENTS)
	cp $< $(CLIENTS)
	cd $(CLIENTS) && npm install --no-audit --no-fund --no-package-lock
	touch $@

$(CLIENTS)/.python: tools/clients/requirements.txt
	$(PYTHON) -m venv $(CLIENTS)/python
	$(CLIENTS)/python/bin/python -m pip install --disable-pip-version-check -q -r $<
	touch $@

$(CLIENTS)/.blender: constraints.txt
	if command -v $(PYTHON313); then $(PYTHON313) -m venv $(CLIENTS)/blender \
		&& $(CLIENTS)/blender/bin/python -m pip install --disable-pip-version-check -q -c $< bpy; fi
	touch $@

$(CLIENTS)/scene.frog: $(VENV)/.ready
	test -e $@ || $(BIN)/frog train examples/captures/room --recipe draft --steps 1500 --scale 0.5 \
		--set low_pass=0.3 --set sh_degree=3 --out $@

test-clients: $(CLIENTS)/.node $(CLIENTS)/.python $(CLIENTS)/.blender $(CLIENTS)/scene.frog
	$(BIN)/python tools/clients/clients.py $(CLIENTS) $(CLIENT_FLAGS)
	$(BIN)/python tools/clients/pace.py $(CLIENTS)

# Wheels of the native library for Windows, macOS and the oldest Linux, in build/cross/wheels, and the zips made of them:
# compiled and looked at, not run: make cross TARGETS=windows-x64. With WINE=wine that for Windows x64 draws,
# with QEMU="qemu-aarch64-static -L /usr/aarch64-linux-gnu" that for Linux on ARM.
TARGETS ?= windows-x64,windows-arm64,macos-arm64,macos-x64,linux-x64,linux-arm64
comma := ,
cross: setup
	$(INSTALL) ziglang
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python tools/cross_build.py build/cross --targets $(TARGETS) $(if $(WINE),--wine "$(WINE)") $(if $(QEMU),--qemu "$(QEMU)")
	for target in $(subst $(comma), ,$(TARGETS)); do for edition in training player; do $(BIN)/python tools/build_extension.py \
		--edition $$edition --platform $$target --wheels build/cross/wheels --output build/cross/zips || exit 1; done; done

# A walk through the add-on in a window, with a screenshot of each step: make tour BLENDER=/path/to/blender OUT=dir
# The Blender's Python needs torch and OpenCV. TOUR_FLAGS is for the script, such as TOUR_FLAGS="--steps 600".
TOUR_FLAGS ?=
tour: TOUR_OUT := $(abspath $(if $(filter command line environment,$(origin OUT)),$(OUT),out/tour))
tour: setup
	mkdir -p $(TOUR_OUT)
	BLENDER_USER_RESOURCES=$(TOUR_OUT)/user $(BLENDER) --factory-startup --window-geometry 0 0 1280 720 \
		--python-exit-code 1 --python tools/window_tour.py -- $(TOUR_OUT) $(TOUR_FLAGS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

extension: setup
	$(BIN)/python tools/build_extension.py --index dist/repository
	$(BIN)/python tools/build_extension.py --edition player

# Everything that a release hands out, for this platform, into dist/release.
$(VENV)/.site: $(VENV)/.ready
	$(INSTALL) mkdocs-material "mkdocstrings[python]" build
	touch $@

release: $(VENV)/.site
	$(BIN)/python tools/release.py

clean:
	rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache frog_blender/engine/native/*frog_native* $(VENV)/.ready
