# The types with which Cython compiles sliding.py.

import cython
from libc.stdint cimport int64_t


@cython.locals(
    first=Py_ssize_t, begin=Py_ssize_t, last=Py_ssize_t, p=Py_ssize_t, k=Py_ssize_t, usual=double, still=double,
    found=double[::1], farthest=double[::1],
)
cpdef directions_of(const double[::1] slip, const double[::1] mismatch, const int64_t[::1] ends, double tolerance)

@cython.locals(k=Py_ssize_t, total=double, least=double, greatest=double)
cdef double reach(const double[::1] values, Py_ssize_t first, Py_ssize_t last) noexcept

@cython.locals(
    k=Py_ssize_t, bottom=Py_ssize_t, begin=Py_ssize_t, end=Py_ssize_t, direction=double, best=double, total=double, least=double,
    highest=double, travelled=double,
)
cdef void slide(
    const double[::1] slip, Py_ssize_t first, Py_ssize_t last, double tolerance, double surely, double[::1] found
) noexcept
