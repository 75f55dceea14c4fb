# Stage (a): action chunks to codes and back.
rule codebook:
    input:
        upstream("codebook"),
    output:
        output("codebook"),
    log:
        log_of("codebook"),
    benchmark:
        benchmark_of("codebook")
    params:
        request=request("codebook"),
    threads: 1
    shell:
        MAKE
