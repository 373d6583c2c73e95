  br label %repeat

repeat:  ; the systems stay in lanes meanwhile
  %r = phi i64 [ 0, %entry ], [ %r.next, %repeated ]
$calls
  br label %repeated

repeated:
  %r.next = add i64 %r, 1
  %again = icmp slt i64 %r.next, %repeats
  br i1 %again, label %repeat, label %finished

finished:
