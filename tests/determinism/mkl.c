/* Makes MKL, PyTorch's library of linear algebra, treat any CPU as one of Intel's: on others it takes other kernels. */
int mkl_serv_intel_cpu_true(void) { return 1; }
int mkl_serv_intel_cpu(void) { return 1; }
