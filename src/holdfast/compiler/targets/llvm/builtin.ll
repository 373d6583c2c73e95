; What the machine code of Python builtins shares: the record that belongs to one builtin, Python's buffers and Python's
; own functions. `builtin.py` appends one of `call_without_arguments.ll` and `call_with_arrays.ll`.

%record = type { ptr, ptr, ptr, ptr, ptr, i64, i64, i64, ptr, i64, ptr, [0 x i64] }
; run, table, fallback, "out", expected, begin and end of its memory, number of inputs, the type of arrays, how many of
; the inputs are given by place, the names of the others, the bytes of each input
%buffer = type { ptr, ptr, i64, i64, i32, i32, ptr, ptr, ptr, ptr, ptr }
; buf, obj, len, itemsize, readonly, ndim, format, shape, strides, suboffsets, internal

declare ptr @PyTuple_GetItem(ptr, i64)
declare i64 @PyTuple_Size(ptr)
declare ptr @PyLong_AsVoidPtr(ptr)
declare ptr @PyLong_FromLongLong(i64)
declare i32 @PyObject_GetBuffer(ptr, ptr, i32)
declare void @PyBuffer_Release(ptr)
declare void @PyErr_Clear()
declare i32 @PyType_IsSubtype(ptr, ptr)
declare void @Py_IncRef(ptr)
declare ptr @PyObject_Vectorcall(ptr, ptr, i64, ptr)
