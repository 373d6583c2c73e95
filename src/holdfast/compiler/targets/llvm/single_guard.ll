; `unsound` returns whether any of n numbers is not finite (x - x is 0 for every finite x); `blank` writes NaN.

define internal i1 @unsound(ptr %x, i64 %n) noinline nounwind {
entry:
  %rest = urem i64 %n, $lanes
  %whole = sub i64 %n, %rest
  %none = icmp eq i64 %whole, 0
  br i1 %none, label %middle, label %wide

wide:
  %e = phi i64 [ 0, %entry ], [ %e.next, %wide ]
  %sum = phi $T [ $zero, %entry ], [ %sum.next, %wide ]
  %at = getelementptr double, ptr %x, i64 %e
  %v = load $T, ptr %at, align 8
  %d = fsub $T %v, %v
  %sum.next = fadd $T %sum, %d
  %e.next = add i64 %e, $lanes
  %more = icmp slt i64 %e.next, %whole
  br i1 %more, label %wide, label %middle

middle:
  %found = phi $T [ $zero, %entry ], [ %sum.next, %wide ]
  %odd = fcmp une $T %found, $zero
  %any = $any_odd
  %even = icmp eq i64 %rest, 0
  br i1 %even, label %done, label %narrow

narrow:
  %i = phi i64 [ %whole, %middle ], [ %i.next, %narrow ]
  %s = phi double [ 0.0, %middle ], [ %s.next, %narrow ]
  %here = getelementptr double, ptr %x, i64 %i
  %y = load double, ptr %here, align 8
  %z = fsub double %y, %y
  %s.next = fadd double %s, %z
  %i.next = add i64 %i, 1
  %again = icmp slt i64 %i.next, %n
  br i1 %again, label %narrow, label %done

done:
  %last = phi double [ 0.0, %middle ], [ %s.next, %narrow ]
  %strange = fcmp une double %last, 0.0
  %result = or i1 %any, %strange
  ret i1 %result
}

define internal void @blank(ptr %x, i64 %n) noinline nounwind {
entry:
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %at = getelementptr double, ptr %x, i64 %e
  store double $nan, ptr %at, align 8
  %e.next = add i64 %e, 1
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  ret void
}
