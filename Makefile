# SPDX-License-Identifier: Apache-2.0
# Everything a user needs: `make demo`, `make test`. `make help` lists the rest.
#
# Where ROS 2 Jazzy is sourced, its own python3, rclpy and colcon are used and no .venv is made:
# `rosdep install --from-paths src --ignore-src` brings what is missing. Elsewhere .venv gets
# the Jazzy wheels and everything else from requirements.lock.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-print-directory

# Neither make nor the scripts of an environment can have a space in their paths.
ifneq ($(words $(CURDIR)),1)
$(error the path of this clone has a space, which its environment cannot have: move it from '$(CURDIR)')
endif

ifeq ($(ROS_DISTRO),jazzy)
PYTHON := python3
ENV_STAMP := build/.ros_checked
else
VENV := $(CURDIR)/.venv
PYTHON := $(VENV)/bin/python
ENV_STAMP := .venv/.installed
export PATH := $(VENV)/bin:$(PATH)
export AMENT_PREFIX_PATH := $(VENV)
export CMAKE_PREFIX_PATH := $(VENV)
endif
COLCON := $(PYTHON) -m colcon --log-level error
QUIET := console_stderr- console_cohesion- console_direct- status- desktop_notification-

# The graph stays on this machine, over Fast DDS, and logs beside the build.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp
export FASTRTPS_DEFAULT_PROFILES_FILE := $(CURDIR)/src/fiber_node/config/fastdds.xml
export ROS_LOG_DIR := $(CURDIR)/log/ros
export PYTHONWARNINGS := ignore:::setuptools,ignore:::pkg_resources

INSTALLED := source install/setup.bash
OUT ?= out/demo
RECORDING ?= out/demo/recording.npz
OPTIONS = $(if $(PRESET),--preset $(PRESET)) $(if $(ROBOTS),--robots $(ROBOTS)) \
	$(if $(SEED),--seed $(SEED)) $(if $(PLANNER),--planner $(PLANNER)) \
	$(if $(LAYOUT),--layout $(LAYOUT)) $(if $(STARTS),--starts $(STARTS)) \
	$(if $(TARGETS),--targets $(TARGETS)) $(if $(SPACING),--spacing $(SPACING)) $(MOTORS)
MOTORS = $(if $(DRIVE),--drive $(DRIVE)) $(if $(MOTORS_ON),--motors-on $(MOTORS_ON))

.PHONY: help
help: ## list the targets
	@grep -hE '^[a-z -]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /|/' | column -t -s '|'
	@echo "demo and bench take PRESET= ROBOTS= SEED= PLANNER= LAYOUT=file STARTS=file TARGETS=file SPACING=mm DRIVE=desi MOTORS_ON=0.55 OUT=folder; demo FAULTS=stall:2,reset FORM=desi TOLERANCE_UM=10"
	@echo "the commands of a running plane take ARGS= for more options, such as ARGS=--help"

.PHONY: venv
venv: $(ENV_STAMP) ## make .venv from requirements.lock (PY=python3.12 chooses the Python)

.venv/.installed: requirements.lock tools/make_venv.sh
	@tools/make_venv.sh .venv requirements.lock $(PY)
	@touch $@

build/.ros_checked: tools/check_ros.py
	@$(PYTHON) tools/check_ros.py
	@mkdir -p build && touch $@

.PHONY: build
build: build/.built ## build the workspace into install/

# The list of source files is an input too: a file that went away needs a build as well.
build/.sources: FORCE
	@mkdir -p build
	@find src -type f -not -path '*/__pycache__/*' -not -path '*/test/*' \
		-not -path '*/.*' -not -path '*.egg-info/*' | LC_ALL=C sort > $@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

.PHONY: FORCE
FORCE:

src/%: ;

build/.built: $(ENV_STAMP) tools/compile_loops.py tools/missing_for_interfaces.sh build/.sources $(shell test -f build/.sources && cat build/.sources)
	@echo "building the workspace"
	@missing="$$(tools/missing_for_interfaces.sh $(PYTHON))"; \
	[ -z "$$missing" ] || echo "fiber_interfaces is left out (action, gateway): without $$missing"; \
	$(COLCON) build --event-handlers $(QUIET) $${missing:+--packages-ignore fiber_interfaces} \
		|| { cat log/latest_build/*/stderr.log; exit 1; }
	@# compiled loops are cached a file each, and do not notice that what they call has changed
	@find src install -name '*.nb[ic]' -delete
	@echo "compiling the loops, once: a minute or two"
	@$(INSTALLED) && $(PYTHON) tools/compile_loops.py
	@touch $@

# $(call command,PACKAGE,EXECUTABLE) is an installed command, as `ros2 run PACKAGE EXECUTABLE`
command = $(INSTALLED) && install/$(1)/lib/$(1)/$(2)

# What would fail after minutes of work fails at once.
.PHONY: inputs
inputs:
	@tools/check_inputs.sh '$(CURDIR)' '$(OUT)' '$(SEED)' '$(ROBOTS)' $(foreach files,$(LAYOUT) $(STARTS) $(TARGETS),'$(files)')

.PHONY: demo
demo: inputs build ## take 5000 simulated robots through one reconfiguration, into out/demo
	@$(INSTALLED) && install/fiber_bringup/lib/fiber_bringup/demo $(OPTIONS) \
		$(if $(FAULTS),--faults $(FAULTS)) $(if $(FORM),--form $(FORM)) \
		$(if $(TOLERANCE_UM),--tolerance-um $(TOLERANCE_UM)) --out $(OUT)

.PHONY: console
console: inputs build ## a simulated plane in a browser until Ctrl-C, into out/live (PORT=, PRESET=, ROBOTS=, DRIVE=, FAULTS=, CAMERA=1, SWAPPED=3-17)
	@$(call command,fiber_bringup,live) $(if $(PRESET),--preset $(PRESET)) $(if $(ROBOTS),--robots $(ROBOTS)) \
		$(if $(SEED),--seed $(SEED)) $(if $(PLANNER),--planner $(PLANNER)) $(if $(LAYOUT),--layout $(LAYOUT)) \
		$(if $(STARTS),--starts $(STARTS)) $(if $(FAULTS),--faults $(FAULTS)) $(if $(PORT),--port $(PORT)) \
		$(MOTORS) $(if $(CAMERA),--camera) $(if $(SWAPPED),--swapped '$(SWAPPED)') \
		--out $(if $(filter file,$(origin OUT)),out/live,$(OUT))

.PHONY: reconfigure
reconfigure: build ## take a running plane to new targets (TARGETS=random:1 or a file)
	@$(call command,fiber_client,reconfigure) $(or $(TARGETS),random:0) $(ARGS)

.PHONY: recover wiring
recover: build ## find robots at unknown places of a running plane with its camera
	@$(call command,fiber_client,recover) $(ARGS)

wiring: build ## tell swapped plugs of a running plane with its camera (TABLE=wiring.csv for a row a robot)
	@$(call command,fiber_client,wiring) $(TABLE) $(ARGS)

.PHONY: show
show: build ## print a topic of a running plane as a table (TOPIC=outcome)
	@$(call command,fiber_client,show) $(or $(TOPIC),outcome) $(ARGS)

.PHONY: disable enable
disable enable: build ## take robots of a running plane out of use, or put them back (IDS="3 17", WHY=); without IDS: list them
	@$(call command,fiber_client,$@) $(or $(IDS),--list) $(if $(WHY),--why '$(WHY)') $(ARGS)

.PHONY: player figures bag
player: build ## write the page of a RECORDING= beside it
	@$(call command,fiber_viewer,player) $(RECORDING) $(ARGS)

figures: build ## draw the figures of a RECORDING= into out/figures, or OUT=
	@$(call command,fiber_viewer,figures) $(RECORDING) -o $(if $(filter file,$(origin OUT)),out/figures,$(OUT)) $(ARGS)

bag: build ## write a RECORDING= as a rosbag2 into out/bag, or OUT=
	@$(call command,fiber_recording,bag) $(RECORDING) $(if $(filter file,$(origin OUT)),out/bag,$(OUT)) $(ARGS)

.PHONY: screenshots
screenshots: build ## take the pictures of docs/images from the last demo, and out/faults, out/camera, out/motors (needs chromium)
	@$(INSTALLED) && $(PYTHON) tools/screenshots.py $(OUT)/recording.npz \
		$(foreach kind,faults camera motors,$(addprefix --$(kind) ,$(wildcard out/$(kind)/recording.npz)))
	@$(INSTALLED) && $(PYTHON) tools/console_picture.py

.PHONY: without-faults
without-faults:
	@[ -z '$(FAULTS)' ] || { echo "bench moves no robots: FAULTS=$(FAULTS) has no effect, use make demo" >&2; exit 1; }

.PHONY: bench
bench: without-faults inputs build ## plan one field with no ROS and print one JSON line, into OUT
	@$(INSTALLED) && $(PYTHON) bench/plan_field.py $(OPTIONS) \
		--out $(if $(filter file,$(origin OUT)),out/bench,$(OUT))

.PHONY: wheel
wheel: $(ENV_STAMP) ## build the wheel of the packages that need no ROS, into dist/
	@$(PYTHON) -m pip wheel --no-deps -w dist .

.PHONY: paper
paper: build ## make docs/paper.md from runs: what the two papers print, and what comes out (minutes)
	@$(INSTALLED) && $(PYTHON) bench/paper.py

KAIJU ?= $(PYTHON)
.PHONY: rivals
rivals: build ## the planner of SDSS-V on the same problems as ours (KAIJU=python that has sdss-kaiju)
	@$(INSTALLED) && $(PYTHON) bench/rivals.py --kaiju-python $(KAIJU) --out bench/results/rivals.md

.PHONY: motors
motors: build ## plan fields for real motors and have them judged (FIELDS=20 LAYOUT=file; goes on after a cut), into bench/results/motors.md
	@$(INSTALLED) && $(PYTHON) bench/motors.py $(if $(LAYOUT),--layout $(LAYOUT)) --fields $(or $(FIELDS),20) \
		--out bench/results/motors.md

.PHONY: geometry
geometry: build ## planes with walls, fibres and gears from real files, judged from the files (FIELDS= of each, PLANES=), into bench/results/geometry.md
	@$(INSTALLED) && $(PYTHON) bench/geometry.py --fields $(or $(FIELDS),2) $(if $(PLANES),--planes $(PLANES))

.PHONY: bench-bus
bench-bus: build ## load, verify and start 5000 robots, on bad buses too, and print a table
	@$(INSTALLED) && $(PYTHON) bench/bus.py --out bench/results/bus.md

CAMPAIGNS ?= 10
.PHONY: soak
soak: build ## campaigns of faults (CAMPAIGNS= of each kind, MIXED=, DRIVE=, LINES=file to go on), REPLAY=kind:seed
	@$(INSTALLED) && if [ -n "$(REPLAY)" ]; then $(PYTHON) bench/soak.py --replay $(REPLAY) $(if $(DRIVE),--drive $(DRIVE)); \
	else $(PYTHON) bench/soak.py --campaigns $(CAMPAIGNS) $(if $(MIXED),--mixed $(MIXED)) \
		$(if $(DRIVE),--drive $(DRIVE)) $(if $(LINES),--lines $(LINES)) && $(PYTHON) bench/fuzz.py; fi

RUNS ?= 90
.PHONY: kill
kill: build ## kill, pause and disturb the processes of a small plane (RUNS= more, SEED=, JOBS=), into bench/results/kill.md
	@trap : INT; $(INSTALLED) && $(PYTHON) bench/kill.py --runs $(RUNS) $(if $(SEED),--seed $(SEED)) \
	$(if $(JOBS),--jobs $(JOBS)); failed=$$?; \
	$(PYTHON) bench/kill_table.py bench/results/kill.jsonl --out bench/results/kill.md; exit $$failed

.PHONY: sector-faults
sector-faults: build ## kill, pause and cut off the hosts of a plane of sectors (RUNS=, SEED=, JOBS=), added to bench/results/sector_faults.jsonl
	@trap : INT; $(INSTALLED) && PYTHONPATH=bench:$$PYTHONPATH $(PYTHON) bench/sector_faults.py --runs $(RUNS) \
		$(if $(SEED),--seed $(SEED)) --jobs $(or $(JOBS),2) --scale $(or $(SCALE),0.15) \
		--lines bench/results/sector_faults.jsonl

FAULTS_AT_ONCE ?= 2
.PHONY: explore
explore: build ## check the protocol in every state that some faults can lead to (FAULTS_AT_ONCE=2)
	@$(INSTALLED) && $(PYTHON) bench/explore.py --faults $(FAULTS_AT_ONCE)

.PHONY: test
test: build ## run every test of the packages and of test/, and count them
	@rm -rf build/*/pytest.xml build/test
	@# the safe path: tests import what is installed, with its compiled loops, and not the folder they run in
	@failed=0; export PYTHONSAFEPATH=1; \
	$(INSTALLED); \
	$(COLCON) test --return-code-on-test-failure --event-handlers $(QUIET) \
		--packages-ignore fiber_interfaces || failed=1; \
	$(COLCON) test-result --test-result-base build --verbose | grep -v '^Summary' || true; \
	$(PYTHON) -m pytest test -n 2 --dist loadfile --junit-xml=build/test/pytest.xml || failed=1; \
	$(PYTHON) test/check_counts.py build test/minimum_tests.toml || failed=1; \
	exit $$failed

.PHONY: lint
lint: $(ENV_STAMP) ## check style, format, complexity and types
	@$(PYTHON) -m ruff check . && $(PYTHON) -m ruff format --check .
	@$(PYTHON) -m basedpyright --pythonpath $(PYTHON)

.PHONY: coverage
coverage: build ## which lines the tests reach, into out/coverage (SUITES="src/fiber_core/test" for some)
	@$(INSTALLED) && tools/coverage.sh out/coverage $(PYTHON) $(SUITES)

TARGET ?=
MUTANTS ?= 200
.PHONY: mutate
mutate: $(ENV_STAMP) ## plant MUTANTS= mistakes (0: all; SEED=, JOBS=, TARGET=clearance), count those the tests notice
	@$(PYTHON) tools/mutate.py --mutants $(MUTANTS) $(if $(SEED),--seed $(SEED)) \
		$(if $(JOBS),--jobs $(JOBS)) $(if $(TARGET),--target $(TARGET))

.PHONY: pictures
pictures: $(ENV_STAMP) ## make the parts of docs that come from the code: architecture, protocol, interfaces
	@$(PYTHON) tools/import_graph.py
	@$(PYTHON) tools/state_diagram.py
	@$(PYTHON) tools/interfaces.py
	@$(PYTHON) tools/security.py

.PHONY: lock
lock: ## resolve requirements.in into requirements.lock
	@tools/lock.sh requirements.in requirements.lock $(PY)

.PHONY: clean
clean: ## remove everything made, except .venv
	@rm -rf build install log out .pytest_cache .ruff_cache .hypothesis
	@find src test bench examples -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

.PHONY: distclean
distclean: clean ## remove .venv too
	@rm -rf .venv
