"""The hyper-parameter grid of Appendix A.1 as jobs: 243 points, or the 13 of notebook 05.

On a cluster, and a dry run of it:

    snakemake -s notebooks/grid.smk --executor slurm --jobs 50 --config preset=thesis subset=all
    snakemake -s notebooks/grid.smk -n --config preset=thesis subset=all

A finished point is an artifact in the cache, so a killed search goes on where it was.
"""

import sys

from cassie_lib import paths
from cassie_lib.grid_search import select_points
from cassie_lib.presets import resolve

PRESET = resolve(config.get("preset", "laptop")).name
SUBSET = config.get("subset", "one_factor")
FOLDER = str(paths.CACHE / f"grid-{PRESET}")
POINTS = [f"{point.number}-{point.seed}" for point in select_points(resolve(PRESET), SUBSET)]


wildcard_constraints:
    number=r"\d+",
    seed=r"\d+",


rule all:
    input:
        f"{FOLDER}/{SUBSET}.jsonl",


rule data:
    output:
        touch(f"{FOLDER}/data.done"),
    params:
        python=sys.executable,
    shell:
        f"{{params.python:q}} -m cassie_lib.grid_search data --preset {PRESET}"


rule point:
    input:
        f"{FOLDER}/data.done",
    output:
        f"{FOLDER}/{{number}}-{{seed}}.json",
    params:
        python=sys.executable,
    shell:
        "{params.python:q} -m cassie_lib.grid_search point {wildcards.number}"
        f" --seed {{wildcards.seed}} --preset {PRESET} > {{output:q}}"


rule table:
    input:
        expand(f"{FOLDER}/{{point}}.json", point=POINTS),
    output:
        f"{FOLDER}/{SUBSET}.jsonl",
    run:
        with open(output[0], "w", encoding="utf-8") as table:
            for name in input:
                with open(name, encoding="utf-8") as point:
                    table.write(point.read())
