# The network that turns an image into a vector.
rule backbone:
    input:
        upstream("backbone"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("backbone"),
    log:
        log_of("backbone"),
    benchmark:
        benchmark_of("backbone")
    params:
        request=request("backbone"),
        known_as=known_as("backbone"),
    priority: 20
    threads: 1
    shell:
        MAKE
