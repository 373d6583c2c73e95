; XLA's programs call all kernels through `handler`; their attribute `key` selects the kernel. XLA's structures are
; those of the C interface of its FFI, version 0.$minor; `foreign_call.py` makes the records.

%extension = type { i64, i32, i32, ptr, ptr }  ; size, kind, -, next, what it is about
%metadata = type { i64, i64, ptr, i32, i32, i32 }  ; size, (size, extension, major, minor) of the interface, traits
%buffers = type { i64, ptr, i64, ptr, ptr }  ; size, extension, count, types, buffers
%attributes = type { i64, ptr, i64, ptr, ptr, ptr }  ; size, extension, count, types, names, attributes
%frame = type { i64, ptr, ptr, ptr, i64, %buffers, %buffers, %attributes }  ; size, extension, interface, context, stage,
; arguments, results, attributes
%buffer = type { i64, ptr, i64, ptr, i64, ptr }  ; size, extension, type, data, rank, dimensions
%number = type { i64, ptr }  ; type, value
%interface = type { i64, ptr, i64, ptr, i32, i32, ptr, ptr }  ; size, extension, version, -, how an error is made
%error = type { i64, ptr, ptr, i32, i32 }  ; size, extension, message, code

%record = type { ptr, ptr, ptr, i64, i64, i64, ptr, ptr, i64, i64, double, [0 x { i64, i64 }] }
; single, prepare, batch, lanes, bytes of working memory for one system and for a batch, free working memory of each,
; number of arrays, index of the status, the undecided status, rank and size of each array

@registry = internal global ptr null  ; how many records, then key and address of each
@unknown = internal constant [$unknown_size x i8] c"$unknown\00"
@exhausted = internal constant [$exhausted_size x i8] c"$exhausted\00"

declare ptr @PyMem_RawCalloc(i64, i64)  ; these two need no global lock
declare void @PyMem_RawFree(ptr)

define void @publish(ptr %records) {
  store atomic ptr %records, ptr @registry release, align 8
  ret void
}

define ptr @handler(ptr %frame) {
entry:
  %extension.at = getelementptr %frame, ptr %frame, i64 0, i32 1
  %extension = load ptr, ptr %extension.at
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %find, label %extended

extended:
  %kind.at = getelementptr %extension, ptr %extension, i64 0, i32 1
  %kind = load i32, ptr %kind.at
  %asks = icmp eq i32 %kind, 1
  br i1 %asks, label %describe, label %find

describe:  ; which version of the interface this is written for
  %metadata.at = getelementptr %extension, ptr %extension, i64 0, i32 4
  %metadata = load ptr, ptr %metadata.at
  %major.at = getelementptr %metadata, ptr %metadata, i64 0, i32 3
  store i32 0, ptr %major.at
  %minor.at = getelementptr %metadata, ptr %metadata, i64 0, i32 4
  store i32 $minor, ptr %minor.at
  %traits.at = getelementptr %metadata, ptr %metadata, i64 0, i32 5
  store i32 0, ptr %traits.at
  ret ptr null

find:
  %attributes.at = getelementptr %frame, ptr %frame, i64 0, i32 7, i32 5
  %attributes = load ptr, ptr %attributes.at
  %attribute = load ptr, ptr %attributes
  %value.at = getelementptr %number, ptr %attribute, i64 0, i32 1
  %value = load ptr, ptr %value.at
  %key = load i64, ptr %value
  %records = load atomic ptr, ptr @registry acquire, align 8
  %count = load i64, ptr %records
  br label %look

look:
  %i = phi i64 [ 0, %find ], [ %i.next, %compare ]
  %i.next = add i64 %i, 1
  %none = icmp uge i64 %i, %count
  br i1 %none, label %missing, label %compare

compare:
  %place = shl i64 %i, 1
  %key.place = add i64 %place, 1
  %other.at = getelementptr i64, ptr %records, i64 %key.place
  %other = load i64, ptr %other.at
  %record.place = add i64 %place, 2
  %record.at = getelementptr ptr, ptr %records, i64 %record.place
  %record = load ptr, ptr %record.at
  %same = icmp eq i64 %key, %other
  br i1 %same, label %found, label %look

found:
  %enough = call i1 @run(ptr %frame, ptr %record)
  br i1 %enough, label %well, label %full

well:
  ret ptr null

missing:
  %error.1 = call ptr @failed(ptr %frame, ptr @unknown, i32 9)
  ret ptr %error.1

full:
  %error.2 = call ptr @failed(ptr %frame, ptr @exhausted, i32 8)
  ret ptr %error.2
}

define internal ptr @failed(ptr %frame, ptr %message, i32 %code) noinline {
  %error = alloca %error
  %size.at = getelementptr %error, ptr %error, i64 0, i32 0
  store i64 32, ptr %size.at
  %extension.at = getelementptr %error, ptr %error, i64 0, i32 1
  store ptr null, ptr %extension.at
  %message.at = getelementptr %error, ptr %error, i64 0, i32 2
  store ptr %message, ptr %message.at
  %code.at = getelementptr %error, ptr %error, i64 0, i32 3
  store i32 %code, ptr %code.at
  %interface.at = getelementptr %frame, ptr %frame, i64 0, i32 2
  %interface = load ptr, ptr %interface.at
  %make.at = getelementptr %interface, ptr %interface, i64 0, i32 7
  %make = load ptr, ptr %make.at
  %made = call ptr %make(ptr %error)
  ret ptr %made
}

; Array k of the kernel: the arguments come first, then the results.
define internal ptr @array(ptr %frame, i64 %k) {
entry:
  %given.at = getelementptr %frame, ptr %frame, i64 0, i32 5, i32 2
  %given = load i64, ptr %given.at
  %arguments.at = getelementptr %frame, ptr %frame, i64 0, i32 5, i32 4
  %arguments = load ptr, ptr %arguments.at
  %results.at = getelementptr %frame, ptr %frame, i64 0, i32 6, i32 4
  %results = load ptr, ptr %results.at
  %is.given = icmp ult i64 %k, %given
  %beyond = sub i64 %k, %given
  %place = select i1 %is.given, i64 %k, i64 %beyond
  %list = select i1 %is.given, ptr %arguments, ptr %results
  %at = getelementptr ptr, ptr %list, i64 %place
  %array = load ptr, ptr %at
  ret ptr %array
}

; Run one system, or a batch if the status has an axis; return false if there is not enough memory.
define internal i1 @run(ptr %frame, ptr %record) {
entry:
  %arrays.at = getelementptr %record, ptr %record, i64 0, i32 8
  %arrays = load i64, ptr %arrays.at
  %status.place.at = getelementptr %record, ptr %record, i64 0, i32 9
  %status.place = load i64, ptr %status.place.at
  %status = call ptr @array(ptr %frame, i64 %status.place)
  %rank.at = getelementptr %buffer, ptr %status, i64 0, i32 4
  %rank = load i64, ptr %rank.at
  %one = icmp eq i64 %rank, 0
  %step = select i1 %one, i64 1, i64 2
  %words = mul i64 %arrays, %step
  %words.and.memory = add i64 %words, 1
  %table = alloca i64, i64 %words.and.memory
  br label %next

next:
  %k = phi i64 [ 0, %entry ], [ %k.next, %place ]
  %k.next = add i64 %k, 1
  %all = icmp eq i64 %k, %arrays
  br i1 %all, label %memory, label %place

place:  ; address, and how far it is to the next system: not at all where there is no axis of systems
  %buffer = call ptr @array(ptr %frame, i64 %k)
  %data.at = getelementptr %buffer, ptr %buffer, i64 0, i32 3
  %data = load ptr, ptr %data.at
  %has.at = getelementptr %buffer, ptr %buffer, i64 0, i32 4
  %has = load i64, ptr %has.at
  %own.at = getelementptr %record, ptr %record, i64 0, i32 11, i64 %k, i32 0
  %own = load i64, ptr %own.at
  %size.at = getelementptr %record, ptr %record, i64 0, i32 11, i64 %k, i32 1
  %size = load i64, ptr %size.at
  %shared = icmp eq i64 %has, %own
  %stride = select i1 %shared, i64 0, i64 %size
  %word = mul i64 %k, %step
  %after = add i64 %word, %step
  %stride.place = sub i64 %after, 1
  %stride.at = getelementptr i64, ptr %table, i64 %stride.place
  store i64 %stride, ptr %stride.at
  %address.at = getelementptr i64, ptr %table, i64 %word
  store ptr %data, ptr %address.at  ; over the stride of one system
  br label %next

memory:
  %bytes.place = select i1 %one, i32 4, i32 5
  %bytes.at = getelementptr i64, ptr %record, i32 %bytes.place
  %bytes = load i64, ptr %bytes.at
  %idle.place = select i1 %one, i32 6, i32 7
  %idle.at = getelementptr ptr, ptr %record, i32 %idle.place
  %idle = atomicrmw xchg ptr %idle.at, ptr null acquire
  %there = icmp ne ptr %idle, null
  br i1 %there, label %enough, label %more

more:  ; another thread has it, or nobody had it yet
  %fresh = call ptr @PyMem_RawCalloc(i64 1, i64 %bytes)
  %got = icmp ne ptr %fresh, null
  br i1 %got, label %enough, label %too.little

too.little:
  ret i1 false

enough:
  %block = phi ptr [ %idle, %memory ], [ %fresh, %more ]
  %start = ptrtoint ptr %block to i64
  %beyond = add i64 %start, 63
  %line = and i64 %beyond, -64
  %arena = inttoptr i64 %line to ptr
  br i1 %one, label %single, label %many

single:
  %arena.at = getelementptr i64, ptr %table, i64 %words
  store ptr %arena, ptr %arena.at
  %prepare.at = getelementptr %record, ptr %record, i64 0, i32 1
  %prepare = load ptr, ptr %prepare.at
  call void %prepare(ptr %table)
  %single.at = getelementptr %record, ptr %record, i64 0, i32 0
  %run.single = load ptr, ptr %single.at
  %code = call i64 %run.single(ptr %table)
  br label %done

many:
  %dimensions.at = getelementptr %buffer, ptr %status, i64 0, i32 5
  %dimensions = load ptr, ptr %dimensions.at
  %systems = load i64, ptr %dimensions
  %lanes.at = getelementptr %record, ptr %record, i64 0, i32 3
  %lanes = load i64, ptr %lanes.at
  %rounded = add i64 %systems, %lanes
  %rounded.up = sub i64 %rounded, 1
  %blocks = udiv i64 %rounded.up, %lanes
  %batch.at = getelementptr %record, ptr %record, i64 0, i32 2
  %batch = load ptr, ptr %batch.at
  call void %batch(ptr %table, i64 0, i64 %blocks, i64 %systems, i64 1, ptr %arena)
  br label %done

done:
  %ran = phi i64 [ 1, %single ], [ %systems, %many ]
  %kept = cmpxchg ptr %idle.at, ptr null, ptr %block release monotonic
  %is.kept = extractvalue { ptr, i1 } %kept, 1
  br i1 %is.kept, label %look, label %free

free:
  call void @PyMem_RawFree(ptr %block)
  br label %look

look:
  call void @withhold(ptr %frame, ptr %record, i64 %arrays, ptr %status, i64 %ran)
  ret i1 true
}

; Set the results of systems with an undecided status to NaN, because the caller cannot resolve it.
define internal void @withhold(ptr %frame, ptr %record, i64 %arrays, ptr %status, i64 %count) {
entry:
  %given.at = getelementptr %frame, ptr %frame, i64 0, i32 5, i32 2
  %given = load i64, ptr %given.at
  %statuses.at = getelementptr %buffer, ptr %status, i64 0, i32 3
  %statuses = load ptr, ptr %statuses.at
  %open.at = getelementptr %record, ptr %record, i64 0, i32 10
  %open.status = load double, ptr %open.at
  br label %system

system:
  %i = phi i64 [ 0, %entry ], [ %i.next, %judge ], [ %i.next, %result ]
  %i.next = add i64 %i, 1
  %judged = icmp eq i64 %i, %count
  br i1 %judged, label %done, label %judge

judge:
  %status.at = getelementptr double, ptr %statuses, i64 %i
  %is = load double, ptr %status.at
  %open = fcmp oeq double %is, %open.status
  br i1 %open, label %result, label %system

result:
  %k = phi i64 [ %given, %judge ], [ %k.next, %number ]
  %k.next = add i64 %k, 1
  %blank = icmp uge i64 %k, %arrays
  br i1 %blank, label %system, label %fill

fill:
  %buffer = call ptr @array(ptr %frame, i64 %k)
  %data.at = getelementptr %buffer, ptr %buffer, i64 0, i32 3
  %data = load ptr, ptr %data.at
  %size.at = getelementptr %record, ptr %record, i64 0, i32 11, i64 %k, i32 1
  %size = load i64, ptr %size.at
  %first = mul i64 %i, %size
  br label %number

number:
  %e = phi i64 [ 0, %fill ], [ %e.next, %write ]
  %e.next = add i64 %e, 1
  %full = icmp eq i64 %e, %size
  br i1 %full, label %result, label %write

write:
  %place = add i64 %first, %e
  %at = getelementptr double, ptr %data, i64 %place
  store double $nan, ptr %at
  br label %number

done:
  ret void
}
