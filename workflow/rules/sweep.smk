# A sweep over samplings, seeds, kernels and numbers of parts. Rows depend on sampling and seed alone, so they are made
# once each; every other point of the sweep reuses them in a work directory of its own, made of hard links.


rule sweep_rows:
    input:
        mesh=SWEEP_MESH,
    output:
        "results/sweep/{sampling}-{seed}/rows.json",
    log:
        "results/logs/sweep/{sampling}-{seed}/rows.log",
    benchmark:
        "results/benchmarks/sweep/{sampling}-{seed}/rows.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(SWEEP_MESH, SWEEP_PLAN, None, attempt),
        disk_mb=lambda w: disk_mb(SWEEP_MESH, SWEEP_PLAN),
        runtime=lambda w, attempt: runtime(SWEEP_MESH, SWEEP_PLAN, None, attempt),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        work="results/sweep/{sampling}-{seed}/work",
        options=SWEEP_ROWS,
    shell:
        "{params.program:q} rows {input.mesh:q} --work-dir {params.work:q} --force {params.options}"
        " --sampling {wildcards.sampling} --seed {wildcards.seed} --threads {threads}"
        " --max-memory {params.memory:q} --progress lines --json={output:q} 2> {log:q}"


rule sweep_point:
    input:
        mesh=SWEEP_MESH,
        rows=rules.sweep_rows.output,
    output:
        labels="results/sweep/{sampling}-{seed}/{kernel}-{k}/parts.seg",
        answer="results/sweep/{sampling}-{seed}/{kernel}-{k}/parts.json",
    log:
        "results/logs/sweep/{sampling}-{seed}/{kernel}-{k}.log",
    benchmark:
        "results/benchmarks/sweep/{sampling}-{seed}/{kernel}-{k}.tsv"
    conda:
        "../envs/nystrom-stream.yaml"
    threads: config["threads"]
    resources:
        mem_mb=lambda w, attempt: mem_mb(SWEEP_MESH, SWEEP_PLAN, ("labels",), attempt),
        runtime=lambda w, attempt: runtime(SWEEP_MESH, SWEEP_PLAN, ("labels",), attempt),
    params:
        program=PROGRAM,
        memory=config["max_memory"],
        rows="results/sweep/{sampling}-{seed}/work",
        work="results/sweep/{sampling}-{seed}/{kernel}-{k}/work",
    # Files of a work directory are replaced, never changed, so links are as good as copies; the lock is each one's own.
    shell:
        "(rm -rf {params.work:q} && mkdir -p {params.work:q}"
        " && find {params.rows:q} -maxdepth 1 -type f ! -name lock -exec ln -t {params.work:q} {{}} +"
        " && {params.program:q} cluster --work-dir {params.work:q} --cluster kmeans -k {wildcards.k}"
        " --kernel {wildcards.kernel} --threads {threads} --max-memory {params.memory:q} --progress lines"
        " -o {output.labels:q} --json={output.answer:q} && rm -rf {params.work:q}) 2> {log:q}"


rule sweep_score:
    input:
        labels=rules.sweep_point.output.labels,
        mesh=SWEEP_MESH,
        truth=SWEEP.get("truth", []),
    output:
        "results/sweep/{sampling}-{seed}/{kernel}-{k}/score.json",
    log:
        "results/logs/sweep/{sampling}-{seed}/{kernel}-{k}.score.log",
    conda:
        "../envs/nystrom-stream.yaml"
    resources:
        mem_mb=500,
        runtime=10,
    params:
        program=PROGRAM,
    shell:
        "{params.program:q} evaluate {input.labels:q} --truth {input.truth:q} --mesh {input.mesh:q} --json={output:q} > {log:q} 2>&1"


rule sweep_table:
    input:
        answers=expand(
            rules.sweep_point.output.answer,
            sampling=SWEEP.get("sampling", []),
            seed=SWEEP.get("seed", []),
            kernel=SWEEP.get("kernel", []),
            k=SWEEP.get("k", []),
        ),
        scores=(
            expand(
                rules.sweep_score.output,
                sampling=SWEEP.get("sampling", []),
                seed=SWEEP.get("seed", []),
                kernel=SWEEP.get("kernel", []),
                k=SWEEP.get("k", []),
            )
            if "truth" in SWEEP
            else []
        ),
    output:
        table=report(
            "results/sweep/sweep.tsv", caption="../report/sweep.rst", category="Sweep"
        ),
        plot=report(
            "results/sweep/sweep.png", caption="../report/sweep.rst", category="Sweep"
        ),
    log:
        "results/logs/sweep/table.log",
    conda:
        "../envs/tables.yaml"
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/sweep.py"
