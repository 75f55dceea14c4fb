# One page, and the tables and figures behind it.
rule report:
    input:
        upstream("report"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("report"),
    log:
        log_of("report"),
    benchmark:
        benchmark_of("report")
    params:
        request=request("report"),
        known_as=known_as("report"),
    threads: 1
    shell:
        MAKE
