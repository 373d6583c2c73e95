; The function that runs a schedule for a batch: groups begin <= b < end of systems, up to $together groups at a time, and
; `repeats` times in a row if the schedule has carried arrays. Row k of `table` holds the address and the stride of
; external array k. Each group has working memory of its own.

define void @batch(ptr %table, i64 %begin, i64 %end, i64 %count, i64 %repeats, ptr %arena) nounwind {
entry:
  %size = add i64 0, $size
$strides
  %varied = icmp ne i64 $varied, 0  ; some parameter differs from system to system
  %any = icmp slt i64 %begin, %end
  br i1 %any, label %next, label %done

next:
  %b = phi i64 [ %begin, %entry ], [ %b.next, %stored ]
  %rest = sub i64 %end, %b
  %together = call i64 @llvm.smin.i64(i64 %rest, i64 $together)
  %start = icmp eq i64 %b, %begin
  %needed = or i1 %start, %varied
  br i1 %needed, label %prepare, label %compute

prepare:
$prepare
  br label %compute

compute:
$compute
  br label %stored

stored:
  %b.next = add i64 %b, %together
  %more = icmp slt i64 %b.next, %end
  br i1 %more, label %next, label %done

done:
  fence seq_cst  ; what went past the caches is there for other threads
  ret void
}
