# Two commands for a fresh machine: `make demo` and `make test`; each sets up what it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# Byte code is kept: to compile the packages anew takes 3 s of every command.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test truth benchmarks screen docs lint clean

demo: $(STAMP)
	$(BIN)/sindy-surge demo

# What takes minutes: the truth recovered over seeds and machines, from whole records.
TRUTH := $(addprefix tests/, $(addsuffix .py, \
	$(addprefix comparisons/missing_effect/, test_hidden_on_the_rig test_diagnosis test_limits \
		test_where test_fit systems/test_open_world systems/test_diagnosis) \
	$(addprefix comparisons/, test_main_job test_work_command test_sparse_whole_run \
		test_total_system test_paper_claims test_structure_command test_methods \
		study/test_bench study/test_comparison study/test_run rig/test_hidden) \
	$(addprefix sindy_surge/, discover/test_loops discover/test_dynamics test_regressor \
		test_held_out test_constraints test_selection test_dead_time test_knots) \
	contracts/test_sparse_lag_regressor_contract mistakes/test_fuzz test_examples))
PYTEST := $(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

# All else.
test: $(STAMP)
	$(PYTEST) $(addprefix --ignore , $(TRUTH) tests/screen tests/benchmarks tests/docs)

truth: $(STAMP)
	$(PYTEST) $(TRUTH)

# That each benchmark runs, at its shortest, and that what it measures with is right.
benchmarks: $(STAMP)
	$(BIN)/python -m pytest -q -n 2 --dist worksteal tests/benchmarks

screen: $(STAMP)
	tests/screen/run

# The pages build, and their commands and Python print what the pages show.
docs: $(STAMP)
	$(BIN)/sphinx-build -q -W --keep-going -n -b html docs docs/_build/html
	$(BIN)/python -m pytest -q -n 2 --dist worksteal tests/docs

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Without byte code, which takes 26 s for all packages at once: each is compiled when imported.
$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $(STAMP)

clean:
	rm -rf $(VENV) demo docs/_build docs/api/generated .mypy_cache .ruff_cache .pytest_cache
