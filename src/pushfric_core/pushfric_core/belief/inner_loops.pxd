# The types with which Cython compiles inner_loops.py.

import cython
from libc cimport math
from libc.stdint cimport int8_t, int64_t

cdef double TINY
cdef int STICKING, SLIDING


@cython.locals(
    n=Py_ssize_t, r=Py_ssize_t, j=Py_ssize_t, i=Py_ssize_t, k=int64_t, at_x=double, at_y=double, turn=double, x=double, y=double,
    rounded=double, near=double, of_xx=double, of_xy=double, of_yy=double, of_xt=double, of_yt=double, of_tt=double,
    ahead=double, across=double, push_x=double, push_y=double, square=double, slowness=double, share=double, xx=double, xy=double,
    yy=double, xt=double, yt=double, give_x=double, give_y=double, give_t=double, aside_x=double, aside_y=double,
    by_force=double, by_both=double, by_moment=double, force=double, least=double, own=double, both=double, of_turn=double,
    determinant=double, inward=double, made_up=double, cosine=double, sine=double, free=double, push=double, moment=double,
    per_force="double[::1]", per_moment="double[::1]", pushes_x="double[::1]", pushes_y="double[::1]", open_="double[::1]",
    gives="double[::1]", turned="double[::1]",
)
cpdef void slopes_each(
    const double[:, ::1] points, const double[::1] w, const double[::1] middle, double arm,
    double rounding, double reach,
    const double[:, :] contacts, const double[:, :] normals, const double[:] turns, const int64_t[:] stretch,
    const double[:, :] twists, const int8_t[:] modes, const double[:, :] forces, double[:, :, ::1] by_push,
    double[:, :, ::1] unknown
) except *


@cython.locals(r=Py_ssize_t, k=int64_t, cosine=double, sine=double, x=double, y=double)
cpdef void sum_each(
    const double[::1] middle, double arm, const double[:] turns, const int64_t[:] stretch, const double[:, :] motions,
    double[:, ::1] sums
) except *


@cython.locals(k=Py_ssize_t, j=Py_ssize_t, x=double, y=double)
cpdef void whiten_each(const double[:, :, :] roots, double[:, :, ::1] values) except *


@cython.locals(
    k=Py_ssize_t, total=double, x=double, y=double, z=double, more=double, xx=double, yy=double, zz=double, xy=double, xz=double,
    yz=double, of_x=double, of_xy=double, of_xz=double, square=double, size=double,
)
cpdef double rescaled(
    const double[:, :] errors, const double[:, :, :] own, const double[:] share, const int64_t[:] freedom, double nu,
    double left, double scale
) except? -1


@cython.locals(k=Py_ssize_t, j=Py_ssize_t, told=double, x=double, y=double, z=double, square=double)
cpdef double student(const double[:] off, const int64_t[:] freedom, double nu, double[::1] weights) except? -1
