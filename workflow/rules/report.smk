# One page, and the tables and figures behind it.
rule report:
    input:
        upstream("report"),
    output:
        output("report"),
    log:
        log_of("report"),
    benchmark:
        benchmark_of("report")
    params:
        request=request("report"),
    threads: 1
    shell:
        MAKE
