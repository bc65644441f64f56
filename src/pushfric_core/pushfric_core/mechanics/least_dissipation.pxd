# The types with which Cython compiles least_dissipation.py.

import cython
from libc cimport math
from libc.stdint cimport int8_t, int64_t

cdef double STILL, SLOWEST, NARROW, CONVERGED, GAIN, FLAT
cdef int BISECTIONS


cdef class Contact:
    cdef const double[:, ::1] points, weights
    cdef double[::1] w, lever, reach, square, moment, rise
    cdef Py_ssize_t size
    cdef double x, y, slip, turn, value, by_slip, by_turn, slip_slip, slip_turn, turn_turn, along

@cython.locals(length=double, arm_x=double, arm_y=double, size=Py_ssize_t, j=Py_ssize_t)
cdef void look(Contact contact, int64_t sample, double at_x, double at_y, double x, double y) noexcept

@cython.locals(
    lever=double, reach=double, value=double, along=double, by_slip=double,
    by_turn=double, slip_slip=double, slip_turn=double, turn_turn=double, ahead=double, across=double, speed=double,
    slowness=double, share=double, growth=double, across_share=double, growth_share=double, j=Py_ssize_t,
)
cdef void dissipate(Contact contact, double slip, double turn) noexcept

@cython.locals(
    lever=double, reach=double, by_turn=double, turn_turn=double, still=double, ahead=double, across=double, slowness=double,
    share=double, growth=double, growth_share=double, j=Py_ssize_t,
)
cdef void turn_only(Contact contact, double turn) noexcept

@cython.locals(low=double, high=double, own=double, turn=double, square=double, narrow=double, last=double, following=double, j=Py_ssize_t)
cdef void stick(Contact contact) noexcept

@cython.locals(
    translation=double, turning=double, slip=double, turn=double, value=double, a=double, b=double, c=double,
    determinant=double, by_slip=double, by_turn=double, decrease=double, length=double, j=Py_ssize_t,
)
cdef bint slide(Contact contact, int steps) noexcept

cdef bint slide_along(
    Contact contact, int64_t sample, double x, double y, double normal_x, double normal_y, double mu_c, int steps
) noexcept

@cython.locals(
    sample=int64_t, x=double, y=double, normal_x=double, normal_y=double, velocity_x=double, velocity_y=double,
    approach=double, speed=double, pressure=double, shear=double, inward=double, omega=double, outcome=Py_ssize_t,
    r=Py_ssize_t,
)
cpdef Py_ssize_t push_each(
    Contact contact, const double[::1] mu_c, const int64_t[::1] samples, const double[:, ::1] points,
    const double[:, ::1] normals, const double[:, ::1] velocities, int steps, double[:, ::1] twists, int8_t[::1] modes,
    double[:, ::1] forces
) except? -3

@cython.locals(edge=double, speed=double, omega=double, r=Py_ssize_t, side=Py_ssize_t)
cpdef Py_ssize_t cone_each(
    Contact contact, const double[::1] mu_c, const int64_t[::1] samples, const double[:, ::1] points,
    const double[:, ::1] normals, int steps, double[:, :, ::1] cones
) except? -3
