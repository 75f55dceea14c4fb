# Stage (a): action chunks to codes and back.
rule codebook:
    input:
        upstream("codebook"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("codebook"),
    log:
        log_of("codebook"),
    benchmark:
        benchmark_of("codebook")
    params:
        request=request("codebook"),
        known_as=known_as("codebook"),
    threads: 1
    shell:
        MAKE
