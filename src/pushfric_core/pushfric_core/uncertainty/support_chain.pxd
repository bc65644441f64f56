# The types with which Cython compiles support_chain.py.

import cython
from libc cimport math
from libc.stdint cimport int64_t

cdef double FIELD, MASS, PLACE, SNAP, NUMBER, SPLIT, EXCHANGE, SIDES, NEAR, APART, TAIL, LEAST_SLOPE, LEAST_AREA, MOST_AREA, STILL
cdef int DRAWS, SHRINKS, NODES, PIVOTED, MIDDLE, NOISE, MISFIT, PUSH, ROUGHNESS, PIVOT, SIDE


cdef class Chain:
    cdef double[:, ::1] motions, contacts, sides, points, modes, hull
    cdef double[:, :, ::1] errors
    cdef double[::1] nodes, links, numbers, draws
    cdef int64_t[::1] pushes
    cdef double[:, :, ::1] columns, foot_columns
    cdef double[:, ::1] area, new_area, total, trial, column
    cdef readonly double[:, ::1] feet, priors
    cdef readonly double[::1] mass, pressure, scales, moments
    cdef double[::1] field, new_field, new_moments, new_pressure, place, low, high
    cdef int64_t[::1] at_point
    cdef double reach, size, extent, warmth
    cdef readonly double fit
    cdef readonly Py_ssize_t count
    cdef Py_ssize_t drawn

@cython.locals(
    root=double, motions=double[:, ::1], errors=double[:, :, ::1], contacts=double[:, ::1], nodes=double[::1],
    arm_x=double, arm_y=double, velocity_x=double, velocity_y=double, speed=double, error_x=double, error_y=double,
    moved_x=double, moved_y=double, above=double, below=double, near=double, i=Py_ssize_t, a=Py_ssize_t, node=Py_ssize_t,
)
cdef void put_column(Chain chain, double x, double y, double[:, ::1] column) noexcept

@cython.locals(
    scales=double[::1], links=double[::1], sides=double[:, ::1], pushes=int64_t[::1], nodes=double[::1], noise=double,
    misfit=double, shared=double, pivot=double, side=double, total=double, squares=double, cross=double, ones=double,
    logs=double, ratio=double, before=double, before_r=double, before_one=double, slope_before=double,
    first_before=double, second_before=double, moment=double, slope=double, first=double, second=double, variance=double,
    r=double, one=double, linked=double, factor=double, spread=double, size=double, p=Py_ssize_t, i=Py_ssize_t,
    h=Py_ssize_t, node=Py_ssize_t,
)
cdef double log_likelihood(Chain chain, double[:, ::1] rows, double[::1] moments) noexcept

cdef double uniform(Chain chain) noexcept

@cython.locals(length=double)
cdef double normal(Chain chain) noexcept

cdef Py_ssize_t index(Chain chain, Py_ssize_t size) noexcept

@cython.locals(
    modes=double[:, ::1], columns=double[:, :, ::1], scale=double, highest=double, value=double, total=double,
    share=double, j=Py_ssize_t, b=Py_ssize_t, row=Py_ssize_t, i=Py_ssize_t,
)
cdef void press(Chain chain, double[::1] field, double roughness, double[::1] pressure, double[:, ::1] rows) noexcept

@cython.locals(
    columns=double[:, :, ::1], mass=double[::1], total=double, share=double, k=Py_ssize_t, row=Py_ssize_t, i=Py_ssize_t
)
cdef void add_up(Chain chain, Py_ssize_t count, double[:, ::1] area, double[:, ::1] out) noexcept

@cython.locals(row=Py_ssize_t, i=Py_ssize_t)
cdef void assign(double[:, ::1] source, double[:, ::1] target) noexcept

@cython.locals(fit=double)
cdef bint accept(Chain chain, double prior) noexcept

@cython.locals(place=double[::1], points=double[:, ::1], j=Py_ssize_t, _=Py_ssize_t)
cdef int64_t choose_place(Chain chain) noexcept

@cython.locals(hull=double[:, ::1], place=double[::1], edge=Py_ssize_t, inside=bint)
cdef bint in_hull(Chain chain) noexcept

@cython.locals(total=double, k=Py_ssize_t)
cdef double total_mass(Chain chain) noexcept

cdef void move_field(Chain chain) noexcept

@cython.locals(
    rows=double[:, ::1], level=double, angle=double, lowest=double, highest=double, fit=double, b=Py_ssize_t, _=Py_ssize_t
)
cdef void move_on_ellipse(Chain chain, double[::1] values, double[::1] others, bint pressing) noexcept

@cython.locals(old=double, other=double, b=Py_ssize_t)
cdef void turn(double[::1] values, double[::1] others, double cosine, double sine) noexcept

@cython.locals(j=Py_ssize_t)
cdef void keep_pressure(Chain chain) noexcept

@cython.locals(k=Py_ssize_t, wide=double, change=double, old=double, new=double)
cdef void move_mass(Chain chain) noexcept

@cython.locals(
    k=Py_ssize_t, j=Py_ssize_t, old_k=double, old_j=double, new_k=double, new_j=double, change=double, prior=double
)
cdef void exchange_mass(Chain chain) noexcept

@cython.locals(
    k=Py_ssize_t, j=Py_ssize_t, feet=double[:, ::1], place=double[::1], at_point=int64_t, aside=double, which=double,
    wide=double,
)
cdef void move_foot(Chain chain) noexcept

@cython.locals(
    feet=double[:, ::1], place=double[::1], share=double, columns=double[:, :, ::1], column=double[:, ::1], total=double[:, ::1],
    trial=double[:, ::1], row=Py_ssize_t, i=Py_ssize_t,
)
cdef void move_to(Chain chain, Py_ssize_t k, int64_t at_point, double prior) noexcept

cdef double log_density(double x, double y, double deviation) noexcept

@cython.locals(points=double[:, ::1], best=Py_ssize_t, least=double, apart=double, j=Py_ssize_t)
cdef Py_ssize_t nearest(Chain chain, double x, double y) noexcept

@cython.locals(
    k=Py_ssize_t, j=Py_ssize_t, feet=double[:, ::1], place=double[::1], points=double[:, ::1], wide=double, density=double
)
cdef void snap(Chain chain) noexcept

@cython.locals(
    count=Py_ssize_t, feet=double[:, ::1], mass=double[::1], place=double[::1], k=Py_ssize_t, last=Py_ssize_t, wide=double,
    x=double, y=double, whole=double, aside_x=double, aside_y=double, part=double, prior=double, one=double, other=double,
)
cdef void split_or_merge(Chain chain) noexcept

@cython.locals(count=Py_ssize_t, k=Py_ssize_t, at_point=int64_t)
cdef void add_or_remove(Chain chain) noexcept

@cython.locals(last=Py_ssize_t, feet=double[:, ::1], mass=double[::1], columns=double[:, :, ::1], a=Py_ssize_t)
cdef void swap_last(Chain chain, Py_ssize_t k) noexcept

@cython.locals(scale=Py_ssize_t, middle=double, deviation=double, old=double, new=double, prior=double)
cdef void move_scale(Chain chain) noexcept

@cython.locals(step=Py_ssize_t, which=double)
cpdef Py_ssize_t walk(Chain chain, Py_ssize_t steps, double warmth, double[::1] draws)
