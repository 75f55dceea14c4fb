# The network that turns an image into a vector.
rule backbone:
    input:
        upstream("backbone"),
    output:
        output("backbone"),
    log:
        log_of("backbone"),
    benchmark:
        benchmark_of("backbone")
    params:
        request=request("backbone"),
    threads: 1
    shell:
        MAKE
